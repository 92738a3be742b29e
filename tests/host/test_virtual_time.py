"""The virtual loop: order, exact jumps, inline executors, deadlocks."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rm501_host.virtual_time import VirtualDeadlockError, run_virtual


@given(st.lists(st.integers(min_value=0, max_value=10**9), min_size=1, max_size=20))
def test_sleepers_wake_in_order_at_their_own_instants(delays_us: list[int]) -> None:
    woken: list[tuple[float, int]] = []

    async def sleeper(delay_us: int) -> None:
        await asyncio.sleep(delay_us / 1e6)
        woken.append((asyncio.get_running_loop().time(), delay_us))

    async def main() -> None:
        async with asyncio.TaskGroup() as group:
            for delay_us in delays_us:
                group.create_task(sleeper(delay_us))

    run_virtual(main())
    assert [delay for _, delay in woken] == sorted(delays_us)
    assert all(abs(at_s - delay / 1e6) < 1e-6 for at_s, delay in woken)


def test_timeouts_are_virtual() -> None:
    async def main() -> float:
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(10_000):
                await asyncio.get_running_loop().create_future()
        return asyncio.get_running_loop().time()

    assert run_virtual(main()) == pytest.approx(10_000)


def test_a_deadlock_is_named_instead_of_hanging() -> None:
    async def main() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(VirtualDeadlockError):
        run_virtual(main())


def test_executor_work_costs_no_virtual_time_and_passes_errors_on() -> None:
    async def main() -> tuple[float, int]:
        loop = asyncio.get_running_loop()
        value = await loop.run_in_executor(None, sum, [1, 2, 3])
        with pytest.raises(ZeroDivisionError):
            await loop.run_in_executor(None, lambda: 1 // 0)
        return loop.time(), value

    assert run_virtual(main()) == (0.0, 6)
