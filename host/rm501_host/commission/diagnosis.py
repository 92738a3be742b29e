"""Is this computer fit for the arm? Stalls of the event loop, round trips to the daemon, motion time queued ahead."""

from __future__ import annotations

import asyncio

from rm501_host.client.client import DaemonClient

_TICK_S = 0.005
_GOOD_ROUND_TRIP_MS = 5.0


async def diagnose(client: DaemonClient, seconds: float) -> dict[str, float | None]:
    """Measure for `seconds`: longest stall here (s), round trips (ms), least queue lead while the arm moves (s; None:
    it did not).
    """
    loop = asyncio.get_running_loop()
    await client.subscribe(20, ("run_state", "queue_lead_s", "rate"))
    stall_s = 0.0
    trips_ms: list[float] = []
    leads_s: list[float] = []
    end_s = loop.time() + seconds
    while loop.time() < end_s:
        before_s = loop.time()
        await asyncio.sleep(_TICK_S)
        stall_s = max(stall_s, loop.time() - before_s - _TICK_S)
        at_s = loop.time()
        await client.call("version")
        trips_ms.append(1e3 * (loop.time() - at_s))
        if client.status.get("run_state") == "RUNNING" and client.status.get("rate", 0.0) > 0.99:
            leads_s.append(float(client.status.get("queue_lead_s", 0.0)))
    trips_ms.sort()
    return {
        "longest_stall_s": stall_s,
        "round_trip_p50_ms": trips_ms[len(trips_ms) // 2],
        "round_trip_p99_ms": trips_ms[int(0.99 * (len(trips_ms) - 1))],
        "least_queue_lead_s": min(leads_s, default=None),
    }


def judge(measured: dict[str, float | None], stall_budget_s: float) -> list[tuple[bool, str]]:
    """What the numbers of `diagnose` mean: (fit, sentence) each. `stall_budget_s`: so long the queue has to last."""
    stall, trip, lead = measured["longest_stall_s"], measured["round_trip_p99_ms"], measured["least_queue_lead_s"]
    assert stall is not None and trip is not None
    found = [
        (
            stall < stall_budget_s / 2,
            f"longest stall {stall:.3f} s; the queue covers {stall_budget_s:.1f} s, half is fit",
        ),
        (
            trip <= _GOOD_ROUND_TRIP_MS,
            f"99 % of round trips within {trip:.2f} ms; {_GOOD_ROUND_TRIP_MS:.0f} ms are fit",
        ),
    ]
    if lead is not None:
        found.append((lead > stall, f"least queue lead in motion {lead:.2f} s; it has to cover a stall"))
    else:
        found.append((True, "nothing moved meanwhile: run a program and repeat, to see the queue lead"))
    return found
