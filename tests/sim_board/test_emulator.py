"""The board on its bench, end to end over `emu://` on virtual time."""

from __future__ import annotations

import asyncio
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rm501_host.virtual_time import run_virtual
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import BoardState
from rm501_protocol.faults import FaultCode
from rm501_protocol.messages import FaultReport, Reset, SetPower
from rm501_sim_board.emu_transport import EmuTransport, open_transport, parse_url, running_board, shut_down
from rm501_sim_board.errors import BenchConfigError
from rm501_sim_board.traces import truth_trace
from tests.support.board_client import BoardClient
from tests.support.pin_decoder import MOTORS, decode
from tests.support.waveform import check_words


async def _ready(url: str) -> tuple[BoardClient, EmuTransport]:
    transport = await open_transport(url)
    client = BoardClient(transport)
    await client.open()
    await client.power_on()
    return client, transport


async def _move(client: BoardClient, *moves: tuple[int, int, float]) -> None:
    for motor, steps, seconds in moves:
        client.jump(motor, steps, seconds)
    client.start()
    await asyncio.sleep(sum(seconds for *_, seconds in moves) + 0.3)


@pytest.mark.parametrize("firmware", ["fast", "reference"])
def test_a_move_arrives_and_its_waveform_is_clean(firmware) -> None:
    async def main() -> None:
        client, transport = await _ready(f"emu://?firmware={firmware}")
        await _move(client, (0, 800, 2.0), (4, -300, 2.0))
        emulator = transport.emulator
        truth = transport.truth()
        _, words = emulator.recording.words()
        judge = decode(words)
        assert [judge.counts[m] for m in MOTORS] == [800, 0, 0, 0, -300]
        assert check_words(words) == []
        assert truth.commanded_steps == (800, 0, 0, 0, -300, 0)
        assert truth.joint_deg[0] == pytest.approx(-60.0 + 800 / 40)
        assert truth.joint_deg[3] == pytest.approx(45.0 - 150 / 26.66666)
        assert truth.joint_deg[4] == pytest.approx(-150 / 26.66666)
        assert truth.heartbeat_edges == emulator.frame
        assert (await client.status()).positions_steps[:5] == (800, 0, 0, 0, -300)
        await transport.aclose()

    run_virtual(main())


def _fingerprints(url: str) -> tuple[str, str, str]:
    async def main() -> tuple[str, str, str]:
        client, transport = await _ready(url)
        await _move(client, (1, -500, 1.5), (2, 400, 1.5), (0, 300, 1.0))
        emulator = transport.emulator
        transport.truth()
        out = (
            emulator.recording.pin_hash,
            truth_trace(emulator.bench).fingerprint(),
            emulator.recording.step_sequence_hash(),
        )
        await transport.aclose()
        return out

    return run_virtual(main())


def test_same_seed_same_pins_and_same_truth_also_in_another_process() -> None:
    url = "emu://?preset=real&seed=11"
    here = _fingerprints(url)
    assert _fingerprints(url) == here
    code = f"from tests.sim_board.test_emulator import _fingerprints; print(*_fingerprints({url!r}))"
    root = Path(__file__).parents[2]
    there = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert tuple(there.stdout.split()) == here
    other_seed = _fingerprints("emu://?preset=real&seed=12")
    assert other_seed[1] != here[1]  # another friction, another truth
    assert other_seed[2] == here[2]  # the same steps


def test_the_reference_firmware_gives_the_same_pins_and_truth() -> None:
    assert _fingerprints("emu://?preset=real&seed=5") == _fingerprints("emu://?preset=real&seed=5&firmware=reference")


def test_the_pin_hash_is_that_of_the_recorded_words() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://")
        await _move(client, (0, 100, 0.5))
        recording = transport.emulator.recording
        _, words = recording.words()
        assert recording.pin_hash == hashlib.sha256(words.astype("<u4").tobytes()).hexdigest()
        frames = np.arange(0, transport.emulator.frame, 100)
        judge = decode(words)
        expected = [sum(s for p, s in judge.steps["waist"] if p < f * 8) for f in frames.tolist()]
        assert recording.positions_steps(frames)[:, 0].tolist() == expected
        await transport.aclose()

    run_virtual(main())


@pytest.mark.parametrize("preset", ["ideal", "real"])
def test_a_stalled_motor_overflows_its_counter_and_only_a_command_resets_it(preset) -> None:
    async def main() -> None:
        client, transport = await _ready(f"emu://?preset={preset}")
        transport.faults.inject("stall:motor=elbow@1s")
        await asyncio.sleep(0.7)
        await _move(client, (2, 600, 2.0))
        bench = transport.emulator.bench
        truth = transport.truth()
        assert truth.overflowed_motors == (2,)
        assert truth.inputs["OVERFLOW_724"]
        assert not truth.inputs["OVERFLOW_732"]
        assert abs(truth.counter_error_steps[2]) == 127
        (report,) = client.of(FaultReport)
        assert report.fault is FaultCode.OVERFLOW
        status = await client.status()
        assert status.state is BoardState.FAULT
        made = status.positions_steps[2]
        assert 127 < made < 160  # steps stopped at once
        # Time and traffic change nothing.
        transport.faults.clear("stall")
        await asyncio.sleep(2.0)
        assert transport.truth().overflowed_motors == (2,)
        assert (await client.status()).state is BoardState.FAULT
        client.send(Reset(FaultCode.OVERFLOW, master_reset=True))
        await asyncio.sleep(0.5)
        truth = transport.truth()
        assert truth.overflowed_motors == ()
        assert (await client.status()).state is not BoardState.FAULT
        assert not (await client.status()).trusted_mask & 1 << 2
        words = bench.recording.words()[1]
        assert len(decode(words).master_reset_periods) == 1
        await transport.aclose()

    run_virtual(main())


def test_a_payload_too_heavy_overflows_board_732() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://?preset=real&fault=payload:kg=14@0.5s")
        await _move(client, (1, 700, 3.0))  # shoulder down, arm out
        truth = transport.truth()
        assert 1 in truth.overflowed_motors
        assert client.of(FaultReport)[0].fault is FaultCode.OVERFLOW
        await transport.aclose()

    run_virtual(main())


def test_without_power_the_arm_sinks_and_power_brings_it_no_position() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://?preset=real")
        before = transport.truth()
        client.send(SetPower(False))
        await asyncio.sleep(4.0)
        after = transport.truth()
        assert not after.powered
        assert after.joint_deg[1] < before.joint_deg[1] - 2.0
        assert after.commanded_steps == before.commanded_steps
        await transport.aclose()

    run_virtual(main())


def test_the_emergency_stop_cuts_the_power_without_software() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://?preset=real")
        bench = transport.emulator.bench
        assert transport.truth().powered
        bench.press(InputId.ESTOP)
        transport.emulator.advance_to(transport.emulator.frame + 1)
        assert not transport.emulator.truth().powered
        await asyncio.sleep(0.2)
        assert (await client.status()).state is BoardState.FAULT
        await transport.aclose()

    run_virtual(main())


def test_power_that_comes_back_finds_a_board_with_another_identity() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://?fault=reset:dark_ms=30@1s")
        first = client.link.identify
        client.jump(0, 2000, 4.0)
        client.start()
        await asyncio.sleep(1.5)
        emulator = transport.emulator
        assert emulator.resets == 1
        counts = transport.truth().commanded_steps
        await asyncio.sleep(1.0)
        assert transport.truth().commanded_steps == counts  # nothing of the old queue runs on
        assert not transport.truth().powered
        again = BoardClient(transport)
        await again.open(nonce=77)
        assert again.link.identify is not None
        assert first is not None
        assert again.link.identify.boot_id != first.boot_id
        assert (await again.status()).trusted_mask == 0
        await transport.aclose()

    run_virtual(main())


def test_a_named_board_outlives_its_transport() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://bench")
        await _move(client, (0, 200, 1.0))
        await transport.aclose()
        await asyncio.sleep(1.0)
        again = await open_transport("emu://bench")
        assert again.emulator is transport.emulator
        client = BoardClient(again)
        await client.open(nonce=5)
        assert (await client.status()).positions_steps[0] == 200
        assert running_board("bench").emulator is again.emulator
        shut_down("bench")
        with pytest.raises(KeyError):
            running_board("bench")
        await again.aclose()

    run_virtual(main())


def test_several_boards_run_side_by_side() -> None:
    async def main() -> None:
        one, first = await _ready("emu://one")
        two, second = await _ready("emu://two")
        one.jump(0, 100, 1.0)
        two.jump(0, -100, 1.0)
        one.start()
        two.start()
        await asyncio.sleep(1.5)
        assert first.truth().commanded_steps[0] == 100
        assert second.truth().commanded_steps[0] == -100
        await first.aclose()
        await second.aclose()
        shut_down("one")
        shut_down("two")

    run_virtual(main())


def test_a_pulled_plug_ends_the_transport_and_the_same_url_finds_the_board_again() -> None:
    async def main() -> None:
        client, transport = await _ready("emu://?fault=unplug@1s/2s")
        await asyncio.sleep(1.0)
        assert isinstance(client.lost, ConnectionResetError)
        with pytest.raises(OSError, match="unplugged"):
            await open_transport("emu://?fault=unplug@1s/2s")
        with pytest.raises(ConnectionError):
            transport.write(b"x")
        await asyncio.sleep(2.5)
        again = await open_transport("emu://?fault=unplug@1s/2s")
        assert again.emulator is transport.emulator
        await again.aclose()

    run_virtual(main())


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("emu://?preset=perfect", "ideal, real, harsh"),
        ("emu://?sneed=3", "unknown parameter 'sneed'"),
        ("emu://?seed=x", "whole number"),
        ("emu://?firmware=c", "fast or reference"),
        ("tcp://", "not an emu"),
    ],
)
def test_a_wrong_url_is_refused_by_name(url, text) -> None:
    with pytest.raises(BenchConfigError, match=text):
        parse_url(url)


class _Silent:
    def phase(self, name: str) -> None:
        pass

    def progress(self, progress: object) -> None:
        pass

    def message(self, text: str) -> None:
        pass


@pytest.mark.parametrize("preset", ["ideal", "real"])
def test_a_configuration_with_another_base_period_is_followed(preset, tmp_path) -> None:
    from rm501_host.config import load_config
    from rm501_host.program_run import RunOptions, run_program

    program = tmp_path / "move.ngc"
    program.write_text("G21 G90\nG0 X240 Y0 Z300 A0 B0\nM2\n")
    config = load_config(Path(__file__).parents[2] / "configs" / "fast.toml")

    async def main() -> None:
        url = f"emu://fast?preset={preset}&pose=-149,101,-89,2,-64"
        result = await run_program(program, config, RunOptions(url, True, lambda: 7), _Silent())
        assert result.error is None
        running = running_board("fast")
        truth = running.truth()
        emulator = running.emulator
        assert (emulator.clock.base_period_us, emulator.clock.frame_us) == (20, 160)
        elapsed_us = asyncio.get_running_loop().time() * 1e6
        assert emulator.frame * 160 == pytest.approx(elapsed_us, abs=25_000)
        assert np.linalg.norm(np.array(truth.tcp_mm) - (240.0, 0.0, 300.0)) < (0.2 if preset == "ideal" else 6.0)
        first, words = emulator.recording.words()
        assert check_words(words[:80_000], first_period=first) == []
        trace = truth_trace(emulator.bench)
        assert trace.t_s[-1] == pytest.approx(elapsed_us * 1e-6, abs=0.03)
        shut_down("fast")

    run_virtual(main())
