"""Every method of the API, declared once: name, parameters, access, what it does. `docs/api.md` is made from it.

Methods that move the arm answer at once with {"motion": number}; `motion.wait` waits for its end.
"""

from __future__ import annotations

import asyncio
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from rm501_host.config import JOINT_NAMES
from rm501_host.daemon.access import Access
from rm501_host.daemon.rpc import API_VERSION, NoParams, Registry
from rm501_host.daemon.service import Client
from rm501_host.errors import RefusedError
from rm501_host.machine import operations, tables
from rm501_host.machine.jobs import Job
from rm501_host.machine.status import MachineStatus
from rm501_host.machine.verify import verify
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import SetOutputs

Name = Annotated[str, Meta(min_length=1, max_length=100)]
Ratio = Annotated[float, Meta(ge=0, le=1)]
Number = Annotated[float, Meta(ge=-1e6, le=1e6)]
MOTION = '{"motion": int}'

api: Registry[Client] = Registry()


class _Params(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


def _started(job: Job) -> dict[str, object]:
    return {"motion": job.id}


# ------------------------------------------------------------------------------------------------ seeing


@api.method("version", NoParams, Access.STOP, result='{"version": str, "api": int}')
async def _version(client: Client, params: NoParams) -> object:
    """Version of the daemon and of this interface."""
    try:
        number = version("rm501")
    except PackageNotFoundError:
        number = "unknown"
    return {"version": number, "api": API_VERSION}


class HelloParams(_Params, frozen=True):
    """A name for this client, shown to others when it owns the motion."""

    name: Name


@api.method("hello", HelloParams, Access.STOP, result='{"client": int}')
async def _hello(client: Client, params: HelloParams) -> object:
    """Give this client a name."""
    client.rename("".join(letter for letter in params.name if letter.isprintable())[:40] or "unnamed")
    return {"client": client.owner.id}


@api.method("methods", NoParams, Access.READ, result="[str]")
async def _methods(client: Client, params: NoParams) -> object:
    """Names of all methods."""
    return [method.name for method in api]


@api.method("status", NoParams, Access.READ, result="MachineStatus")
async def _status(client: Client, params: NoParams) -> object:
    """The whole status."""
    return client.service.status()


class SubscribeParams(_Params, frozen=True):
    """Period in ms (20 is the shortest) and the fields wanted (empty: all)."""

    period_ms: Annotated[int, Meta(ge=20, le=60_000)] = 100
    fields: Annotated[tuple[Name, ...], Meta(max_length=64)] = ()


@api.method("subscribe", SubscribeParams, Access.READ, result="MachineStatus")
async def _subscribe(client: Client, params: SubscribeParams) -> object:
    """Get the status now, and its changes as notifications `status` from now on (at most 50 a second)."""
    unknown = set(params.fields) - set(MachineStatus.__struct_fields__)
    if unknown:
        raise RefusedError(f"the status has no field {', '.join(sorted(unknown))}; see docs/api.md")
    return client.subscribe(params.period_ms / 1000, frozenset(params.fields))


@api.method("unsubscribe", NoParams, Access.READ)
async def _unsubscribe(client: Client, params: NoParams) -> object:
    """End the subscription."""
    client.unsubscribe()
    return None


class LogParams(_Params, frozen=True):
    """How many records."""

    count: Annotated[int, Meta(ge=1, le=500)] = 50


@api.method("log", LogParams, Access.READ, result="[record]")
async def _log(client: Client, params: LogParams) -> object:
    """The newest records of the log."""
    records = list(client.machine.log.ring)[-params.count :]
    return [msgspec.Raw(record.encode().rstrip()) for record in records]


# ----------------------------------------------------------------------------------------------- stopping


@api.method("stop", NoParams, Access.STOP)
async def _stop(client: Client, params: NoParams) -> object:
    """STOP, category 1: down to rest on the path, motors off. From anybody, at any time, in every state."""
    await client.machine.stop(client.owner)
    return None


@api.method("kill", NoParams, Access.STOP)
async def _kill(client: Client, params: NoParams) -> object:
    """KILL, category 0: no more steps at once. The position is lost. From anybody."""
    await client.machine.stop(client.owner, StopKind.KILL)
    return None


@api.method("hold", NoParams, Access.STOP, result='{"held": bool}')
async def _hold(client: Client, params: NoParams) -> object:
    """Feed hold: down to rest on the path, motors on, everything kept. From anybody. A jog ends."""
    return {"held": await client.machine.hold(client.owner)}


# ----------------------------------------------------------------------------------------- state and lease


class ResetParams(_Params, frozen=True):
    """The latched fault to clear, by name as status shows it (null when there is none); whether to switch the motors
    on.
    """

    fault: Name | None = None
    power: bool = True


@api.method("reset", ResetParams, Access.FULL)
async def _reset(client: Client, params: ResetParams) -> object:
    """Leave ESTOP or OFF: clear the named fault, drop what is queued, motors on. Nothing moves."""
    await client.machine.reset(client.owner, params.fault, power=params.power)
    return None


@api.method("power_off", NoParams, Access.FULL)
async def _power_off(client: Client, params: NoParams) -> object:
    """Motors off, at rest."""
    await client.machine.power_off(client.owner)
    return None


@api.method("lease.take", NoParams, Access.FULL)
async def _lease_take(client: Client, params: NoParams) -> object:
    """Own the motion until given back or disconnected. A motion takes the lease by itself while it lasts."""
    client.machine.lease.take(client.owner)
    return None


@api.method("lease.give_back", NoParams, Access.FULL)
async def _lease_give_back(client: Client, params: NoParams) -> object:
    """Give the lease back."""
    client.machine.lease.give_back(client.owner)
    return None


@api.method("resume", NoParams, Access.FULL)
async def _resume(client: Client, params: NoParams) -> object:
    """Go on after a hold, M0, M1 or a single block. Refused while another client keeps the lease."""
    await client.machine.resume(client.owner)
    return None


@api.method("abort", NoParams, Access.FULL)
async def _abort(client: Client, params: NoParams) -> object:
    """End the motion: down to rest on the path, motors on, position trusted, the rest dropped."""
    await client.machine.abort(client.owner)
    return None


class OverrideParams(_Params, frozen=True):
    """1 is as programmed; 0 holds."""

    ratio: Ratio


@api.method("override", OverrideParams, Access.FULL)
async def _override(client: Client, params: OverrideParams) -> object:
    """Feed override, at once and along the path. Above 1: give `program.run` a speed."""
    await client.machine.set_override(params.ratio, client.owner)
    return None


# ------------------------------------------------------------------------------------------------ moving


class WaitParams(_Params, frozen=True):
    """Number of the motion; how long to wait, s."""

    motion: Annotated[int, Meta(ge=1)]
    timeout_s: Annotated[float, Meta(ge=0, le=86_400)] = 60.0


@api.method("motion.wait", WaitParams, Access.READ, result='{"done": bool, "result": object}')
async def _wait(client: Client, params: WaitParams) -> object:
    """Wait for the end of a motion; an error that ended it is raised here. `done` is false after the timeout."""
    job = client.machine.jobs.get(params.motion)
    try:
        async with asyncio.timeout(params.timeout_s):
            return {"done": True, "result": await job.wait()}
    except TimeoutError:
        return {"done": False, "result": {}}


class HomeParams(_Params, frozen=True):
    """Joints to home, all when empty."""

    joints: Annotated[tuple[Name, ...], Meta(max_length=5)] = ()


@api.method("home", HomeParams, Access.FULL, result=MOTION)
async def _home(client: Client, params: HomeParams) -> object:
    """Home joints on their switches, in the configured sequence."""
    return _started(operations.home(client.machine, client.owner, params.joints))


@api.method("verify", HomeParams, Access.FULL, result=MOTION)
async def _verify(client: Client, params: HomeParams) -> object:
    """Touch the switches of homed joints again and measure lost steps; the result has them per joint."""
    return _started(verify(client.machine, client.owner, params.joints))


class JointsParams(_Params, frozen=True):
    """Joint angles, deg; speed as a share of the limits."""

    q_deg: Annotated[tuple[Number, ...], Meta(min_length=5, max_length=5)]
    speed: Annotated[float, Meta(gt=0, le=1)] = 1.0


@api.method("move.joints", JointsParams, Access.FULL, result=MOTION)
async def _move_joints(client: Client, params: JointsParams) -> object:
    """Go to joint angles, straight in joint space."""
    return _started(operations.move_joints(client.machine, client.owner, params.q_deg, params.speed))


class LinearParams(_Params, frozen=True):
    """X Y Z (mm) A B C (deg) in the program frame, feed in mm/s (at most 250)."""

    target: Annotated[tuple[Number, ...], Meta(min_length=6, max_length=6)]
    feed_mm_s: Annotated[float, Meta(gt=0, le=operations.TEACH_SPEED_MM_S)] = 50.0


@api.method("move.linear", LinearParams, Access.FULL, result=MOTION)
async def _move_linear(client: Client, params: LinearParams) -> object:
    """Go straight to a point of the program frame."""
    return _started(operations.move_linear(client.machine, client.owner, params.target, params.feed_mm_s))


class JogParams(_Params, frozen=True):
    """Frame and axis (joint: waist shoulder elbow pitch roll; world: x y z a b c; tool: x y z); speed in deg/s or mm/s,
    signed; distance in deg or mm, null: until `jog.end`, or until nobody calls `jog.keep` for 200 ms.
    """

    frame: Literal["joint", "world", "tool"]
    axis: Name
    speed: Number
    distance: Annotated[float, Meta(gt=0, le=1000)] | None = None


@api.method("jog.start", JogParams, Access.FULL, result=MOTION)
async def _jog_start(client: Client, params: JogParams) -> object:
    """Start a jog. It goes as far as the limits allow and no farther."""
    return _started(
        client.service.jogger.start(client.owner, params.frame, params.axis, params.speed, distance=params.distance)
    )


class JogKeepParams(_Params, frozen=True):
    """Number of the motion that `jog.start` gave."""

    motion: Annotated[int, Meta(ge=1)]


@api.method("jog.keep", JogKeepParams, Access.FULL, result='{"moving": bool}')
async def _jog_keep(client: Client, params: JogKeepParams) -> object:
    """The key is still pressed: renew the lease for 200 ms."""
    return {"moving": client.service.jogger.keep(client.owner, params.motion)}


@api.method("jog.end", NoParams, Access.FULL)
async def _jog_end(client: Client, params: NoParams) -> object:
    """The key was released: down to rest now."""
    client.service.jogger.end(client.owner)
    return None


class HandParams(_Params, frozen=True):
    """open or close."""

    action: Literal["open", "close"]


@api.method("hand", HandParams, Access.FULL, result=MOTION)
async def _hand(client: Client, params: HandParams) -> object:
    """Open or close the hand and wait for its stroke. What status says of it is commanded, not confirmed."""
    return _started(operations.hand(client.machine, client.owner, opened=params.action == "open"))


class OutputParams(_Params, frozen=True):
    """Digital output 0..7."""

    output: Annotated[int, Meta(ge=0, le=7)]
    on: bool


@api.method("output", OutputParams, Access.FULL)
async def _output(client: Client, params: OutputParams) -> object:
    """Switch a digital output."""
    client.machine.lease.require(client.owner)
    mask = 1 << params.output
    levels = mask if params.on else 0
    await client.machine.session.command(SetOutputs(mask, levels), lambda status: status.outputs & mask == levels)
    client.machine.write_log("output", output=params.output, on=params.on, who=client.owner.name)
    return None


# ---------------------------------------------------------------------------------------------- programs


class BlockParams(_Params, frozen=True):
    """One block of G-code."""

    block: Annotated[str, Meta(min_length=1, max_length=255)]


@api.method("mdi", BlockParams, Access.FULL, result=MOTION)
async def _mdi(client: Client, params: BlockParams) -> object:
    """Run one block; modes and parameters stay from block to block."""
    return _started(await client.service.programs.mdi(client.owner, params.block))


@api.method("mdi.history", NoParams, Access.READ, result="[str]")
async def _mdi_history(client: Client, params: NoParams) -> object:
    """Blocks given so far, oldest first."""
    return client.service.programs.mdi_history


@api.method("program.list", NoParams, Access.READ, result="[str]")
async def _program_list(client: Client, params: NoParams) -> object:
    """Names of the programs."""
    return client.service.programs.files.names()


class UploadParams(_Params, frozen=True):
    """A piece of a program: its name, where the piece starts (bytes of UTF-8), the text, whether it is the last."""

    name: Name
    text: Annotated[str, Meta(max_length=48_000)]
    offset: Annotated[int, Meta(ge=0)] = 0
    last: bool = True


@api.method("program.upload", UploadParams, Access.FULL, result='{"bytes": int}')
async def _program_upload(client: Client, params: UploadParams) -> object:
    """Store a program; a piece at a time when it is long."""
    files = client.service.programs.files
    return {"bytes": files.upload(client.owner.id, params.name, params.offset, params.text, last=params.last)}


class ProgramParams(_Params, frozen=True):
    """Name of the program, line to begin at, speed 0..2 as a factor of the programmed feeds."""

    name: Name
    line: Annotated[int, Meta(ge=1, le=10_000_000)] = 1
    speed: Annotated[float, Meta(gt=0, le=2)] = 1.0


@api.method("program.check", ProgramParams, Access.FULL, result='{"duration_s": float, "complete": bool, ...}')
async def _program_check(client: Client, params: ProgramParams) -> object:
    """Interpret and plan a program from where the arm is; nothing moves."""
    checked = await client.service.programs.load(params.name, line=params.line, speed=params.speed)
    return {
        "name": checked.name,
        "duration_s": round(checked.duration_s, 6),
        "motion_s": round(checked.motion_s, 6),
        "complete": checked.complete,
        "checked_to_line": checked.checked_to_line,
    }


@api.method("program.run", ProgramParams, Access.FULL, result=MOTION)
async def _program_run(client: Client, params: ProgramParams) -> object:
    """Check a program, then run it; after a stop, `line` goes on from where it ended when an operator says so."""
    job = await client.service.programs.run(client.owner, params.name, line=params.line, speed=params.speed)
    return _started(job)


class SwitchParams(_Params, frozen=True):
    """On or off."""

    on: bool


@api.method("single_block", SwitchParams, Access.FULL)
async def _single_block(client: Client, params: SwitchParams) -> object:
    """Stop after every block that moves; takes effect when a program starts, `off` at once."""
    client.machine.lease.require_control(client.owner)
    client.service.programs.single_block = params.on
    return None


@api.method("optional_stop", SwitchParams, Access.FULL)
async def _optional_stop(client: Client, params: SwitchParams) -> object:
    """Pause at M1."""
    client.machine.lease.require_control(client.owner)
    client.service.programs.optional_stop = params.on
    return None


# ------------------------------------------------------------------------------------------- teach points


def _point(name: str, number: int, q_deg: tuple[float, ...], note: str) -> dict[str, object]:
    return {"name": name, "number": number, "q_deg": list(q_deg), "note": note}


@api.method("teach.list", NoParams, Access.READ, result="[point]")
async def _teach_list(client: Client, params: NoParams) -> object:
    """All teach points by number."""
    return [_point(p.name, p.number, p.q_deg, p.note) for p in client.service.teach.points]


class TeachRecordParams(_Params, frozen=True):
    """Name and note of the point."""

    name: Name
    note: Annotated[str, Meta(max_length=200)] = ""


@api.method("teach.record", TeachRecordParams, Access.FULL, result="point")
async def _teach_record(client: Client, params: TeachRecordParams) -> object:
    """Record where the arm stands, under a new or an old name."""
    machine = client.machine
    machine.lease.require(client.owner)
    if missing := machine.arm_state.unhomed():
        raise RefusedError(f"not homed: {', '.join(missing)}; a point recorded now would mean nothing")
    if machine.job is not None:
        raise RefusedError("the arm moves; record when it is at rest")
    point = client.service.teach.record(params.name, machine.arm_state.joints_deg, params.note)
    machine.write_log("teach", name=point.name, number=point.number)
    return _point(point.name, point.number, point.q_deg, point.note)


class TeachEditParams(_Params, frozen=True):
    """The point, and what changes: its name, its angles, its note."""

    name: Name
    new_name: Name | None = None
    q_deg: Annotated[tuple[Number, ...], Meta(min_length=5, max_length=5)] | None = None
    note: Annotated[str, Meta(max_length=200)] | None = None


@api.method("teach.edit", TeachEditParams, Access.FULL, result="point")
async def _teach_edit(client: Client, params: TeachEditParams) -> object:
    """Change a point."""
    client.machine.lease.require(client.owner)
    teach = client.service.teach
    point = teach.edit(params.name, params.q_deg, params.note)
    if params.new_name is not None and params.new_name != params.name:
        point = teach.rename(params.name, params.new_name)
    return _point(point.name, point.number, point.q_deg, point.note)


class TeachNameParams(_Params, frozen=True):
    """The point."""

    name: Name


@api.method("teach.delete", TeachNameParams, Access.FULL)
async def _teach_delete(client: Client, params: TeachNameParams) -> object:
    """Forget a point."""
    client.machine.lease.require(client.owner)
    client.service.teach.delete(params.name)
    return None


class TeachGoParams(_Params, frozen=True):
    """The point; joint: straight in joint space at `speed` of the limits; linear: straight, at 50 mm/s x speed."""

    name: Name
    how: Literal["joint", "linear"] = "joint"
    speed: Annotated[float, Meta(gt=0, le=1)] = 0.5


@api.method("teach.go", TeachGoParams, Access.FULL, result=MOTION)
async def _teach_go(client: Client, params: TeachGoParams) -> object:
    """Go to a point."""
    machine = client.machine
    point = client.service.teach.get(params.name)
    if params.how == "joint":
        return _started(operations.move_joints(machine, client.owner, point.q_deg, params.speed))
    target = machine.arm.program_from_joints(point.q_deg)
    return _started(operations.move_linear(machine, client.owner, target, 100.0 * params.speed))


# ------------------------------------------------------------------------------------ configuration, tables


@api.method("tools.list", NoParams, Access.READ, result="[tool]")
async def _tools_list(client: Client, params: NoParams) -> object:
    """The tool table."""
    return tables.tool_list(client.service.around)


class ToolParams(_Params, frozen=True):
    """Number; offset X Y Z in mm (Z along the tool); diameter; comment."""

    number: Annotated[int, Meta(ge=1, le=99_999)]
    offset_mm: Annotated[tuple[Number, ...], Meta(min_length=3, max_length=3)]
    diameter_mm: Annotated[float, Meta(ge=0, le=1000)] = 0.0
    comment: Annotated[str, Meta(max_length=80)] = ""


@api.method("tools.set", ToolParams, Access.FULL, result="tool")
async def _tools_set(client: Client, params: ToolParams) -> object:
    """Add or replace a tool; at rest."""
    _changes_tables(client)
    tool = tables.set_tool(client.service.around, params.number, params.offset_mm, params.diameter_mm, params.comment)
    client.machine.write_log("tool", **tool)
    return tool


class ToolNumberParams(_Params, frozen=True):
    """Number of the tool."""

    number: Annotated[int, Meta(ge=1, le=99_999)]


@api.method("tools.delete", ToolNumberParams, Access.FULL)
async def _tools_delete(client: Client, params: ToolNumberParams) -> object:
    """Remove a tool; at rest."""
    _changes_tables(client)
    tables.delete_tool(client.service.around, params.number)
    return None


@api.method("offsets.list", NoParams, Access.READ, result="[offset]")
async def _offsets_list(client: Client, params: NoParams) -> object:
    """The work coordinate systems G54 to G59.3."""
    return tables.offset_list(client.service.around, client.machine.arm)


class OffsetParams(_Params, frozen=True):
    """G54 to G59.3; X Y Z A B C in mm and deg; rotation about Z in deg."""

    name: Name
    offset: Annotated[tuple[Number, ...], Meta(min_length=6, max_length=6)]
    rotation_deg: Annotated[float, Meta(ge=-360, le=360)] = 0.0


@api.method("offsets.set", OffsetParams, Access.FULL)
async def _offsets_set(client: Client, params: OffsetParams) -> object:
    """Set a work coordinate system; at rest."""
    _changes_tables(client)
    tables.set_offset(client.service.around, client.machine.arm, params.name, params.offset, params.rotation_deg)
    client.machine.write_log("offset", system=params.name, offset=params.offset, rotation_deg=params.rotation_deg)
    return None


def _changes_tables(client: Client) -> None:
    client.machine.lease.require(client.owner)
    if client.machine.job is not None:
        raise RefusedError("the arm moves; change tables when it is at rest")
    client.service.programs.forget_modes()


@api.method("config", NoParams, Access.READ, result="object")
async def _config(client: Client, params: NoParams) -> object:
    """The configuration in force."""
    return msgspec.to_builtins(client.service.config)


@api.method("joints", NoParams, Access.READ, result="[str]")
async def _joints(client: Client, params: NoParams) -> object:
    """Names of the joints in order."""
    return list(JOINT_NAMES)
