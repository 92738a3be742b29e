"""Methods that move: home, verify, joint and linear moves, jogs, the hand, outputs."""

from __future__ import annotations

import asyncio
from typing import Annotated, Literal

from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import MOTION, Name, Number, Params, api, started
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client
from rm501_host.machine import operations
from rm501_host.machine.trajectories import TimedPoints, follow
from rm501_host.machine.verify import verify
from rm501_protocol.messages import SetOutputs

Row = Annotated[tuple[Number, ...], Meta(min_length=5, max_length=5)]
Seconds = Annotated[float, Meta(ge=0, le=86_400)]


class WaitParams(Params, frozen=True):
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


class HomeParams(Params, frozen=True):
    """Joints to home, all when empty."""

    joints: Annotated[tuple[Name, ...], Meta(max_length=5)] = ()


@api.method("home", HomeParams, Access.FULL, result=MOTION)
async def _home(client: Client, params: HomeParams) -> object:
    """Home joints on their switches, in the configured sequence."""
    return started(operations.home(client.machine, client.owner, params.joints))


@api.method("verify", HomeParams, Access.FULL, result=MOTION)
async def _verify(client: Client, params: HomeParams) -> object:
    """Touch the switches of homed joints again and measure lost steps; the result has them per joint."""
    return started(verify(client.machine, client.owner, params.joints))


class JointsParams(Params, frozen=True):
    """Joint angles, deg; speed as a share of the limits."""

    q_deg: Annotated[tuple[Number, ...], Meta(min_length=5, max_length=5)]
    speed: Annotated[float, Meta(gt=0, le=1)] = 1.0


@api.method("move.joints", JointsParams, Access.FULL, result=MOTION)
async def _move_joints(client: Client, params: JointsParams) -> object:
    """Go to joint angles, straight in joint space."""
    return started(operations.move_joints(client.machine, client.owner, params.q_deg, params.speed))


class LinearParams(Params, frozen=True):
    """X Y Z (mm) A B C (deg) in the program frame, feed in mm/s (at most 250)."""

    target: Annotated[tuple[Number, ...], Meta(min_length=6, max_length=6)]
    feed_mm_s: Annotated[float, Meta(gt=0, le=operations.TEACH_SPEED_MM_S)] = 50.0


@api.method("move.linear", LinearParams, Access.FULL, result=MOTION)
async def _move_linear(client: Client, params: LinearParams) -> object:
    """Go straight to a point of the program frame."""
    return started(operations.move_linear(client.machine, client.owner, params.target, params.feed_mm_s))


class TrajectoryParams(Params, frozen=True):
    """Points of five joints, deg; when each is reached, s, rising from 0 or later; velocities there, deg/s (null: those
    of a spline). A first point at time 0 must be where the arm is, the last velocity 0. `stretch` slows a trajectory
    down that is too fast, by the least that makes it legal. `more` keeps the points and waits for the next call to
    add to them: a message holds some 600 points.
    """

    points_deg: Annotated[tuple[Row, ...], Meta(min_length=1, max_length=5000)]
    times_s: Annotated[tuple[Seconds, ...], Meta(min_length=1, max_length=5000)]
    velocities_deg_s: Annotated[tuple[Row, ...], Meta(max_length=5000)] | None = None
    stretch: bool = False
    more: bool = False


@api.method("move.trajectory", TrajectoryParams, Access.FULL, result='{"motion": int} or {"points": int}')
async def _move_trajectory(client: Client, params: TrajectoryParams) -> object:
    """Follow joint angles that are timed from outside; checked as a whole before anything moves."""
    kept, client.trajectory = client.trajectory, None
    timed = TimedPoints(params.points_deg, params.times_s, params.velocities_deg_s)
    timed = timed if kept is None else kept.extended(timed)
    if params.more:
        client.machine.lease.require(client.owner)
        client.trajectory = timed
        return {"points": len(timed.times_s)}
    return started(await follow(client.machine, client.owner, timed, stretch=params.stretch))


class JogParams(Params, frozen=True):
    """Frame and axis (joint: waist shoulder elbow pitch roll; world: x y z a b c; tool: x y z); speed in deg/s or mm/s,
    signed; distance in deg or mm, null: until `jog.end`, or until nobody calls `jog.keep` for 200 ms. The motion's
    result: `ended` (why the way ends), `damped`, `deviation_mm`, `joints_deg`.
    """

    frame: Literal["joint", "world", "tool"]
    axis: Name
    speed: Number
    distance: Annotated[float, Meta(gt=0, le=1000)] | None = None


@api.method("jog.start", JogParams, Access.FULL, result=MOTION)
async def _jog_start(client: Client, params: JogParams) -> object:
    """Start a jog. It goes as far as the limits allow and no farther, through singularities damped."""
    return started(
        client.service.jogger.start(client.owner, params.frame, params.axis, params.speed, distance=params.distance)
    )


class JogKeepParams(Params, frozen=True):
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


class HandParams(Params, frozen=True):
    """open or close."""

    action: Literal["open", "close"]


@api.method("hand", HandParams, Access.FULL, result=MOTION)
async def _hand(client: Client, params: HandParams) -> object:
    """Open or close the hand and wait for its stroke. What status says of it is commanded, not confirmed."""
    return started(operations.hand(client.machine, client.owner, opened=params.action == "open"))


class OutputParams(Params, frozen=True):
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
