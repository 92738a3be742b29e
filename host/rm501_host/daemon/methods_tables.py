"""Methods for the tool table, the work offsets, and what the configuration says."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rm501_host.config import JOINT_NAMES
from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import Name, Number, Params, api
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client
from rm501_host.errors import RefusedError
from rm501_host.machine import tables


@api.method("tools.list", NoParams, Access.READ, result="[tool]")
async def _tools_list(client: Client, params: NoParams) -> object:
    """The tool table."""
    return tables.tool_list(client.service.around)


class ToolParams(Params, frozen=True):
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


class ToolNumberParams(Params, frozen=True):
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


class OffsetParams(Params, frozen=True):
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
