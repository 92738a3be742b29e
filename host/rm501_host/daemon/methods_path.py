"""Methods that act on the path of a program under way: the feed override, running back along it."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from rm501_host.daemon.access import Access
from rm501_host.daemon.declared import Params, api
from rm501_host.daemon.service import Client
from rm501_host.machine.feed_override import HIGHEST_OVERRIDE
from rm501_host.planner.run_back import KEPT_S


class OverrideParams(Params, frozen=True):
    """1 is as programmed; 0 holds; at most 2."""

    ratio: Annotated[float, Meta(ge=0, le=HIGHEST_OVERRIDE)]


@api.method("override", OverrideParams, Access.FULL)
async def _override(client: Client, params: OverrideParams) -> object:
    """Feed override, along the path. Up to 1 at once. Above it programs and MDI are planned anew for higher feeds,
    half a second or so ahead and within every limit; everything else stays at 1.
    """
    await client.machine.set_override(params.ratio, client.owner)
    return None


class BackParams(Params, frozen=True):
    """How far back, s of path time at 100 %."""

    seconds: Annotated[float, Meta(gt=0, le=KEPT_S)]


@api.method("program.back", BackParams, Access.FULL, result='{"seconds": float, "repeats": [string]}')
async def _back(client: Client, params: BackParams) -> object:
    """Run a held program back along its path; the arm is held again there, and `resume` goes forward. The hand and the
    outputs stay as they are on the way back; going forward repeats them. `seconds`: how far it will be; `repeats`: what
    the hand and the outputs will do again, in words.
    """
    way = await client.service.programs.run_back(client.owner, params.seconds)
    return {"seconds": round(way.seconds, 6), "repeats": list(way.repeats)}
