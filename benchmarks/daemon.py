"""The daemon against real processes: round trips and CPU, take-aways at random instants, random calls, the long loop.

python -m benchmarks.daemon [--part roundtrip,kill,fuzz,soak] [--n 200] [--fuzz 1e5] [--hours 24] [--traced-cycles N]
                              [--short]

roundtrip   status over the unix socket while a program runs: p50, p99 (target 5 ms); CPU of the daemon (target 25 %)
kill        kill -9 of the daemon or of a jogging client, SIGSTOP for 5 s, the pty unplugged, at n random instants; the
            bench itself says where the arm stands: at rest, on its path, nothing goes on before an operator acts
fuzz        random calls through the dispatcher: no crash, no internal error
soak        the pick-and-place in a loop in virtual time with byte errors: no step lost, no growth, no missed event
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from pathlib import Path

from benchmarks.daemon_soak import soak
from benchmarks.daemon_takeaways import A, Bench, kill, ready
from rm501_host.errors import Rm501Error
from tests.operator.processes import REPOSITORY, client_of, start_daemon

P99_TARGET_MS = 5.0
CPU_TARGET = 0.25


# ------------------------------------------------------------------------------------------------ round trips


def cpu_s(process: int) -> float:
    """CPU time that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def roundtrip(count: int) -> bool:
    """Ask for the status while a program runs, with two subscribers at 50 Hz."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench = Bench(folder)
        await bench.start()
        daemon = await start_daemon(folder)
        try:
            async with client_of(folder) as client, client_of(folder, "watcher"):
                await ready(client)
                await client.motion("move.joints", q_deg=A)
                text = (REPOSITORY / "examples" / "pick_and_place.ngc").read_text()
                await client.call("program.upload", name="p.ngc", text=text)
                run = await client.call("program.run", name="p.ngc")
                await client.status_where(lambda now: now["run_state"] == "RUNNING")
                began_s, began_cpu_s = time.perf_counter(), cpu_s(daemon.child.pid)
                trips_ms = []
                while (await client.call("motion.wait", motion=run["motion"], timeout_s=0))["done"] is False:
                    if len(trips_ms) >= count:
                        break
                    at = time.perf_counter()
                    await client.call("status")
                    trips_ms.append(1e3 * (time.perf_counter() - at))
                    await asyncio.sleep(0.02)
                share = (cpu_s(daemon.child.pid) - began_cpu_s) / (time.perf_counter() - began_s)
                await client.call("abort")
        finally:
            await daemon.end()
            assert bench.process is not None
            await bench.process.end(signal.SIGKILL)
    trips_ms.sort()
    p50, p99 = trips_ms[len(trips_ms) // 2], trips_ms[int(0.99 * (len(trips_ms) - 1))]
    load = os.getloadavg()[0]
    print(f"round trip of status while a program runs, {len(trips_ms)} calls, machine load {load:.1f}")
    print(f"  p50 {p50:.2f} ms, p99 {p99:.2f} ms (target {P99_TARGET_MS}), max {trips_ms[-1]:.2f} ms")
    print(f"  CPU of the daemon {share:.1%} of one core, two subscribers at 50 Hz (target {CPU_TARGET:.0%})")
    return p99 <= P99_TARGET_MS and share <= CPU_TARGET


# ------------------------------------------------------------------------------------------- random calls


def fuzz(count: int, seed: int) -> bool:
    """Random calls to every method."""
    from rm501_host.daemon.access import Access
    from rm501_host.daemon.methods import api
    from rm501_host.daemon.rpc import Code, Dispatcher
    from rm501_host.daemon.service import Client
    from rm501_host.virtual_time import run_virtual
    from tests.support.rpc_fuzz import random_call
    from tests.support.virtual_machine import running_service

    codes: dict[str, int] = {}

    async def calls(folder: Path) -> None:
        async with running_service(folder) as service:
            client = service.connect("fuzz", Access.FULL, lambda message: None, lambda: 0)
            dispatcher: Dispatcher[Client] = Dispatcher(api)
            source = random.Random(seed)
            for _ in range(count):
                answer = await dispatcher.answer(random_call(source, frozenset({"motion.wait"})), client)
                decoded = json.loads(answer) if answer is not None else {"none": 1}
                for one in decoded if isinstance(decoded, list) else [decoded]:
                    code = one.get("error", {}).get("code")
                    name = "ok" if code is None else Code(code).name
                    codes[name] = codes.get(name, 0) + 1
                await asyncio.sleep(0.005)

    with tempfile.TemporaryDirectory() as name:
        began_s = time.perf_counter()
        run_virtual(calls(Path(name)))
    took_s = time.perf_counter() - began_s
    print(
        f"{count} random calls, {count / took_s:.0f} a second, no crash: "
        + ", ".join(f"{k} {v}" for k, v in sorted(codes.items()))
    )
    return codes.get("INTERNAL_ERROR", 0) == 0


def main() -> int:
    """Run the chosen parts; exit code 1 when a target is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.daemon", description=__doc__)
    parser.add_argument("--part", default="roundtrip,kill,fuzz,soak")
    parser.add_argument("--n", type=lambda text: int(float(text)), default=200, help="take-aways")
    parser.add_argument("--fuzz", type=lambda text: int(float(text)), default=100_000)
    parser.add_argument("--hours", type=float, default=24.0, help="of virtual time")
    parser.add_argument(
        "--traced-cycles", type=int, default=0, help="cycles of every hundred of the soak under tracemalloc"
    )
    parser.add_argument("--calls", type=int, default=1500, help="round trips")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--short", action="store_true", help="a minute or two: no take-aways, 5,000 calls, 3 cycles")
    options = parser.parse_args()
    parts = options.part.split(",")
    if options.short:
        options.fuzz, options.hours, options.calls = 5000, 0.0, 300
        parts = [part for part in parts if part != "kill"]
    good = True
    try:
        if "roundtrip" in parts:
            good &= asyncio.run(roundtrip(options.calls))
        if "kill" in parts:
            good &= asyncio.run(kill(options.n, options.seed))
        if "fuzz" in parts:
            good &= fuzz(options.fuzz, options.seed)
        if "soak" in parts:
            good &= soak(options.hours, options.seed, options.traced_cycles)
    except (Rm501Error, TimeoutError) as error:
        traceback.print_exc()
        print(f"daemon: MISSED, {type(error).__name__}: {error}")
        return 1
    print(f"daemon: {'all targets met' if good else 'a target was MISSED'} ({', '.join(parts)})")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
