"""Ticks that are left out change nothing: the wire carries the same bytes at the same times as with every tick."""

from __future__ import annotations

from pathlib import Path

import pytest

from rm501_host.config import load_config
from rm501_host.motion import Progress
from rm501_host.program_run import RunOptions, run_program
from rm501_host.virtual_time import run_virtual
from rm501_sim_board.emu_transport import running_board, shut_down
from rm501_sim_board.pacing import PacedBoard

CONFIG = Path(__file__).parents[2] / "configs" / "thesis.toml"
PROGRAM = CONFIG.parents[1] / "examples" / "pick_and_place.ngc"


class _Silent:
    def phase(self, name: str) -> None: ...

    def progress(self, progress: Progress) -> None: ...

    def message(self, text: str) -> None: ...


def _run(query: str) -> tuple[list[tuple[int, str, bytes]], str, str]:
    wire: list[tuple[int, str, bytes]] = []

    async def main() -> tuple[list[tuple[int, str, bytes]], str, str]:
        options = RunOptions(f"emu://paced?{query}", True, lambda: 7, lambda *tap: wire.append(tap))
        result = await run_program(PROGRAM, load_config(CONFIG), options, _Silent())
        running_board("paced").board.run_to_now()
        running_board("paced").truth()  # up to now, also where the last ticks were left out
        words = running_board("paced").emulator.recording.pin_hash
        shut_down("paced")
        return wire, words, result.report.result

    return run_virtual(main())


@pytest.mark.parametrize("query", ["preset=real&seed=1", "preset=ideal&fault=stall:motor=waist@55s"])
def test_left_out_ticks_do_not_show(query, monkeypatch) -> None:
    ticks = [0]
    tick = PacedBoard._tick

    def counted(self: PacedBoard) -> None:
        ticks[0] += 1
        tick(self)

    monkeypatch.setattr(PacedBoard, "_tick", counted)
    few = _run(query)
    few_ticks, ticks[0] = ticks[0], 0
    monkeypatch.setattr("rm501_sim_board.pacing._LEFT_OUT_S", 0.0)
    assert _run(query) == few
    assert few_ticks < 0.95 * ticks[0]
