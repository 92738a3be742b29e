"""Methods that guide the machine and a motion under way: stop, hold, reset, lease, resume, override."""

from __future__ import annotations

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import Name, Params, Ratio, api
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client
from rm501_protocol.link_events import StopKind


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


class ResetParams(Params, frozen=True):
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


class OverrideParams(Params, frozen=True):
    """1 is as programmed; 0 holds."""

    ratio: Ratio


@api.method("override", OverrideParams, Access.FULL)
async def _override(client: Client, params: OverrideParams) -> object:
    """Feed override, at once and along the path. Above 1: give `program.run` a speed."""
    await client.machine.set_override(params.ratio, client.owner)
    return None
