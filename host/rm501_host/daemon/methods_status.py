"""Methods that look: status, its changes, the log, and who is who."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import Annotated

import msgspec
from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import Name, Params, api
from rm501_host.daemon.rpc import API_VERSION, NoParams
from rm501_host.daemon.service import Client
from rm501_host.errors import RefusedError
from rm501_host.machine.status import MachineStatus


@api.method("version", NoParams, Access.STOP, result='{"version": str, "api": int}')
async def _version(client: Client, params: NoParams) -> object:
    """Version of the daemon and of this interface."""
    try:
        number = version("rm501")
    except PackageNotFoundError:
        number = "unknown"
    return {"version": number, "api": API_VERSION}


class HelloParams(Params, frozen=True):
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


class SubscribeParams(Params, frozen=True):
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


class LogParams(Params, frozen=True):
    """How many records."""

    count: Annotated[int, Meta(ge=1, le=500)] = 50


@api.method("log", LogParams, Access.READ, result="[record]")
async def _log(client: Client, params: LogParams) -> object:
    """The newest records of the log."""
    records = list(client.machine.log.ring)[-params.count :]
    return [msgspec.Raw(record.encode().rstrip()) for record in records]
