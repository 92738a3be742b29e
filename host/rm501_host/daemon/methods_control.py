"""Methods that guide the machine and a motion under way: stop, hold, reset, lease, resume, override, limits."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import Name, Number, Params, api
from rm501_host.daemon.rpc import NoParams
from rm501_host.daemon.service import Client
from rm501_protocol.link_events import StopKind


@api.method("stop", NoParams, Access.STOP)
async def _stop(client: Client, params: NoParams) -> object:
    """STOP, category 1: down to rest on the path, motors off. From anybody, at any time, in every state. An error says
    that it was not delivered, or that the board has not acknowledged it.
    """
    await client.machine.stop(client.owner)
    return None


@api.method("kill", NoParams, Access.STOP)
async def _kill(client: Client, params: NoParams) -> object:
    """KILL, category 0: no more steps at once. The position is lost. From anybody."""
    await client.machine.stop(client.owner, StopKind.KILL)
    return None


@api.method("hold", NoParams, Access.STOP, result='{"held": bool}')
async def _hold(client: Client, params: NoParams) -> object:
    """Feed hold: down to rest on the path, motors on, everything kept. From anybody. A jog ends. `held`: false when
    nothing moves; an error when there is no board to tell it to.
    """
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


@api.method("abort", NoParams, Access.FULL, result='{"ended": bool}')
async def _abort(client: Client, params: NoParams) -> object:
    """End the motion: down to rest on the path, motors on, position trusted, the rest dropped. `ended`: false when
    there is none.
    """
    return {"ended": await client.machine.abort(client.owner)}


class LimitsParams(Params, frozen=True):
    """Velocities (deg/s) and accelerations (deg/s2) by the joint's name, and the tool's speed (mm/s); what is not named
    stays. None can be above the configuration file's, nor below a hundredth of it.
    """

    velocity_deg_s: Annotated[dict[Name, Number], Meta(max_length=5)] = msgspec.field(default_factory=dict)
    acceleration_deg_s2: Annotated[dict[Name, Number], Meta(max_length=5)] = msgspec.field(default_factory=dict)
    tcp_speed_mm_s: Annotated[float, Meta(gt=0, le=1e6)] | None = None


LIMITS = '{"in_force": limits, "hard": limits}'


def _limits(client: Client) -> dict[str, object]:
    limits = client.machine.limits
    return {"in_force": limits.in_force, "hard": limits.hard}


@api.method("limits.get", NoParams, Access.READ, result=LIMITS)
async def _limits_get(client: Client, params: NoParams) -> object:
    """The limits in force, and those of the configuration file."""
    return _limits(client)


@api.method("limits.set", LimitsParams, Access.FULL, result=LIMITS)
async def _limits_set(client: Client, params: LimitsParams) -> object:
    """Lower the limits, from the next motion on; logged with old and new values. A restart forgets them."""
    machine = client.machine
    machine.lease.require_control(client.owner)
    old = machine.limits.in_force
    machine.limits.set(params.velocity_deg_s, params.acceleration_deg_s2, params.tcp_speed_mm_s)
    machine.write_log("limits", who=client.owner.name, old=old, new=machine.limits.in_force)
    return _limits(client)


@api.method("limits.reset", NoParams, Access.FULL, result=LIMITS)
async def _limits_reset(client: Client, params: NoParams) -> object:
    """Back to the limits of the configuration file, from the next motion on."""
    machine = client.machine
    machine.lease.require_control(client.owner)
    old = machine.limits.in_force
    machine.limits.reset()
    machine.write_log("limits", who=client.owner.name, old=old, new=machine.limits.in_force)
    return _limits(client)
