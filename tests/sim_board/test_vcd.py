"""The VCD read back by an independent reader says what the pins, the lines and the arm did."""

from __future__ import annotations

import asyncio
from pathlib import Path

from vcdvcd import VCDVCD

from rm501_host.virtual_time import run_virtual
from rm501_sim_board.bench import Bench
from rm501_sim_board.emu_transport import open_transport
from rm501_sim_board.vcd import write_vcd
from tests.support.board_client import BoardClient
from tests.support.pin_decoder import PINS, bit_of


def _recorded(path: Path, url: str = "emu://") -> Bench:
    async def main() -> Bench:
        transport = await open_transport(f"{url}{'&' if '?' in url else '?'}vcd={path}")
        client = BoardClient(transport)
        await client.open()
        await client.power_on()
        client.jump(0, 60, 0.3)
        client.start()
        await asyncio.sleep(0.5)
        await transport.aclose()
        return transport.emulator.bench

    return run_virtual(main())


def _level(dump: VCDVCD, name: str, time_us: int) -> int:
    return int(dump[name][time_us], 2)


def test_every_pin_reads_back_at_every_period(tmp_path) -> None:
    bench = _recorded(tmp_path / "run.vcd")
    dump = VCDVCD(str(tmp_path / "run.vcd"))
    _, words = bench.recording.words()
    for name in PINS:
        signal = dump[f"pins.{name.replace(' ', '_')}"]
        changes = {int(t): int(v, 2) for t, v in signal.tv}
        level = None
        for period, word in enumerate(words.tolist()):
            level = changes.get(period * 40, level)
            assert level == word >> bit_of(name) & 1, (name, period)


def test_motor_counts_and_angles_read_back(tmp_path) -> None:
    bench = _recorded(tmp_path / "run.vcd")
    dump = VCDVCD(str(tmp_path / "run.vcd"))
    assert int(dump["motors.waist_steps"].tv[-1][1], 2) == 60
    assert abs(float(dump["motors.waist_deg"].tv[-1][1]) - (-60.0 + 60 / 40)) < 1e-9
    assert _level(dump, "lines.MOTOR_POWER", 400_000) == 1
    assert bench.truth().commanded_steps[0] == 60


def test_a_swapped_select_shows_as_a_difference_between_pins_and_lines(tmp_path) -> None:
    url = "emu://?fault=swap:line=elbow_select,with=waist_select"
    bench = _recorded(tmp_path / "swap.vcd", url)
    dump = VCDVCD(str(tmp_path / "swap.vcd"))
    pins = [(t, v) for t, v in dump["pins.ELBOW_SELECT"].tv]
    lines = [(t, v) for t, v in dump["lines.WAIST_SELECT"].tv]
    assert [(t, "10"[int(v, 2)]) for t, v in pins] == [(t, v) for t, v in lines]
    assert bench.truth().commanded_steps[2] == 60  # the elbow moved instead of the waist


def test_a_range_of_frames_can_be_written_alone(tmp_path) -> None:
    bench = _recorded(tmp_path / "all.vcd")
    assert write_vcd(bench, tmp_path / "part.vcd", 200, 300) == 100
    part = VCDVCD(str(tmp_path / "part.vcd"))
    assert part.begintime == 200 * 320
    assert part.endtime == 300 * 320
