"""Methods for programs: MDI, upload, check, run, the switches that act on them."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import MOTION, Name, Params, api, started
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client


class BlockParams(Params, frozen=True):
    """One block of G-code."""

    block: Annotated[str, Meta(min_length=1, max_length=255)]


@api.method("mdi", BlockParams, Access.FULL, result=MOTION)
async def _mdi(client: Client, params: BlockParams) -> object:
    """Run one block; modes and parameters stay from block to block."""
    return started(await client.service.programs.mdi(client.owner, params.block))


@api.method("mdi.history", NoParams, Access.READ, result="[str]")
async def _mdi_history(client: Client, params: NoParams) -> object:
    """Blocks given so far, oldest first."""
    return client.service.programs.mdi_history


@api.method("program.list", NoParams, Access.READ, result="[str]")
async def _program_list(client: Client, params: NoParams) -> object:
    """Names of the programs."""
    return client.service.programs.files.names()


class UploadParams(Params, frozen=True):
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


class ProgramParams(Params, frozen=True):
    """Name of the program, line to begin at, speed 0..2 as a factor of the programmed feeds."""

    name: Name
    line: Annotated[int, Meta(ge=1, le=10_000_000)] = 1
    speed: Annotated[float, Meta(gt=0, le=2)] = 1.0


@api.method("program.check", ProgramParams, Access.FULL, result='{"duration_s": float, "complete": bool, ...}')
async def _program_check(client: Client, params: ProgramParams) -> object:
    """Interpret and plan a program from where the arm is; nothing moves. Refused while a motion is under way."""
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
    return started(job)


class SwitchParams(Params, frozen=True):
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
