"""Methods for teach points."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import MOTION, Name, Number, Params, api, started
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client
from rm501_host.errors import RefusedError
from rm501_host.machine import operations
from rm501_host.teach import require_within_ranges


def _point(name: str, number: int, q_deg: tuple[float, ...], note: str) -> dict[str, object]:
    return {"name": name, "number": number, "q_deg": list(q_deg), "note": note}


@api.method("teach.list", NoParams, Access.READ, result="[point]")
async def _teach_list(client: Client, params: NoParams) -> object:
    """All teach points by number."""
    return [_point(p.name, p.number, p.q_deg, p.note) for p in client.service.teach.points]


class TeachRecordParams(Params, frozen=True):
    """Name and note of the point; whether it may replace one of that name."""

    name: Name
    note: Annotated[str, Meta(max_length=200)] = ""
    replace: bool = False


@api.method("teach.record", TeachRecordParams, Access.FULL, result="point")
async def _teach_record(client: Client, params: TeachRecordParams) -> object:
    """Record where the arm stands under a new name, with `replace` also under one that is taken."""
    machine = client.machine
    machine.lease.require(client.owner)
    if missing := machine.arm_state.unhomed():
        raise RefusedError(f"not homed: {', '.join(missing)}; a point recorded now would mean nothing")
    if machine.job is not None:
        raise RefusedError("the arm moves; record when it is at rest")
    point = client.service.teach.record(
        params.name, machine.arm_state.joints_deg, params.note, replace_old=params.replace
    )
    machine.write_log("teach", name=point.name, number=point.number, q_deg=point.q_deg)
    return _point(point.name, point.number, point.q_deg, point.note)


class TeachEditParams(Params, frozen=True):
    """The point, and what changes: its name, its angles, its note."""

    name: Name
    new_name: Name | None = None
    q_deg: Annotated[tuple[Number, ...], Meta(min_length=5, max_length=5)] | None = None
    note: Annotated[str, Meta(max_length=200)] | None = None


@api.method("teach.edit", TeachEditParams, Access.FULL, result="point")
async def _teach_edit(client: Client, params: TeachEditParams) -> object:
    """Change a point. Angles outside the joint ranges are refused."""
    client.machine.lease.require(client.owner)
    teach = client.service.teach
    if params.q_deg is not None:
        require_within_ranges(params.name, params.q_deg, client.service.config)
    point = teach.edit(params.name, params.q_deg, params.note)
    if params.new_name is not None and params.new_name != params.name:
        point = teach.rename(params.name, params.new_name)
    return _point(point.name, point.number, point.q_deg, point.note)


class TeachNameParams(Params, frozen=True):
    """The point."""

    name: Name


@api.method("teach.delete", TeachNameParams, Access.FULL)
async def _teach_delete(client: Client, params: TeachNameParams) -> object:
    """Forget a point."""
    client.machine.lease.require(client.owner)
    client.service.teach.delete(params.name)
    return None


class TeachGoParams(Params, frozen=True):
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
        return started(operations.move_joints(machine, client.owner, point.q_deg, params.speed))
    target = machine.arm.program_from_joints(point.q_deg)
    return started(operations.move_linear(machine, client.owner, target, 100.0 * params.speed))
