"""The same program over every kind of port gives the same steps; the control socket; the command line."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from rm501_host.transports import open_transport
from rm501_host.virtual_time import run_virtual
from rm501_protocol.enums import BoardState
from rm501_protocol.messages import FaultReport
from rm501_sim_board.can_ports import BusPort, SlcanPort
from rm501_sim_board.cli import main as command_line
from rm501_sim_board.control import ControlCommands, ControlSocket
from rm501_sim_board.emu_transport import open_transport as open_emulated
from rm501_sim_board.emulator import EmulatorOptions
from rm501_sim_board.presets import preset
from rm501_sim_board.running import RunningBoard, RunOptions
from rm501_sim_board.serial_ports import PtyPort, TcpPort
from tests.support.board_client import BoardClient
from tests.support.patience import PATIENCE_S, until_answer

_MOVES = ((0, 90, 0.4), (2, -60, 0.6), (4, 40, 0.6), (0, -30, 0.4))


async def _play(client: BoardClient) -> None:
    await client.open()
    await client.power_on()
    for motor, steps, seconds in _MOVES:
        client.jump(motor, steps, seconds)
    client.start()
    await until_answer(
        client.status, lambda now: now.motion_frame == client.next_frame and now.state is BoardState.READY
    )


def _gone(path: str) -> bool:
    return not os.path.lexists(path)


def _expected() -> str:
    async def main() -> str:
        transport = await open_emulated("emu://")
        await _play(BoardClient(transport))
        transport.board.run_to_now()
        steps = transport.emulator.recording.step_sequence_hash()
        await transport.aclose()
        return steps

    return run_virtual(main())


@asynccontextmanager
async def _served(kind: str, folder: Path) -> AsyncIterator[tuple[RunningBoard, str]]:
    loop = asyncio.get_running_loop()
    can = kind in ("slcan", "virtual")
    options = RunOptions(EmulatorOptions(preset("ideal"), packets=can), baud=None if can else 250_000, tick_s=0.002)
    running = RunningBoard.power_up(options, loop)
    if kind == "pty":
        port: PtyPort | TcpPort | BusPort = PtyPort(running.board, folder / "arm", loop)
        url = str(folder / "arm")
    elif kind == "tcp":
        port = await TcpPort.listen(running.board, "127.0.0.1", 0, loop)
        url = f"socket://127.0.0.1:{port.port}"
    elif kind == "slcan":
        port = SlcanPort(running.board, folder / "can", loop)
        url = f"can:slcan:{folder / 'can'}"
    else:
        port = BusPort(running.board, "virtual", "bench", loop)
        url = "can:virtual:bench"
    try:
        yield running, url
    finally:
        await port.aclose()
        running.close()


@pytest.mark.parametrize("kind", ["pty", "tcp", "slcan", "virtual"])
def test_the_same_program_gives_the_same_steps_over_every_port(kind, tmp_path) -> None:
    async def main() -> str:
        async with _served(kind, tmp_path) as (running, url):
            transport = await open_transport(url)
            await _play(BoardClient(transport))
            await transport.aclose()
            running.board.run_to_now()
            return running.emulator.recording.step_sequence_hash()

    assert asyncio.run(main()) == _expected()


def test_can_frames_that_overtake_each_other_change_nothing(tmp_path) -> None:
    async def main() -> str:
        async with _served("virtual", tmp_path) as (running, url):
            running.faults.inject("reorder:p=0.05")
            transport = await open_transport(url)
            client = BoardClient(transport)
            await _play(client)
            assert client.link.stats.retransmits + running.emulator.board.link.stats.retransmits > 0
            await transport.aclose()
            running.board.run_to_now()
            return running.emulator.recording.step_sequence_hash()

    assert asyncio.run(main()) == _expected()


def test_a_second_tcp_client_is_turned_away_and_the_first_stays(tmp_path) -> None:
    async def main() -> None:
        async with _served("tcp", tmp_path) as (_, url):
            first = BoardClient(await open_transport(url))
            await first.open()
            second = BoardClient(await open_transport(url))
            second.transport.start(second)
            await second.until(lambda: second.closed)
            await first.status()
            await first.transport.aclose()

    asyncio.run(main())


def test_the_pty_goes_and_comes_with_the_plug(tmp_path) -> None:
    async def main() -> None:
        async with _served("pty", tmp_path) as (running, url):
            client = BoardClient(await open_transport(url))
            await client.open()
            running.faults.inject("unplug")
            await client.until(lambda: client.closed)
            assert _gone(url)
            running.faults.clear("unplug")
            again = BoardClient(await open_transport(url))
            await again.open(nonce=9)
            await again.transport.aclose()
            await client.transport.aclose()

    asyncio.run(main())


def test_the_pty_does_not_overwrite_a_file(tmp_path) -> None:
    (tmp_path / "arm").write_text("precious")

    async def main() -> None:
        async with _served("pty", tmp_path):
            pass

    with pytest.raises(Exception, match="no symbolic link"):
        asyncio.run(main())
    assert (tmp_path / "arm").read_text() == "precious"


def test_the_control_socket_presses_loads_breaks_and_tells_the_truth(tmp_path) -> None:
    async def main() -> None:
        async with _served("tcp", tmp_path) as (running, url):
            loop = asyncio.get_running_loop()
            control = await ControlSocket.listen(ControlCommands(running), str(tmp_path / "control"), loop)
            reader, writer = await asyncio.open_unix_connection(str(tmp_path / "control"))

            async def ask(**request: object) -> dict[str, object]:
                writer.write(json.dumps(request).encode() + b"\n")
                answer: dict[str, object] = json.loads(await asyncio.wait_for(reader.readline(), PATIENCE_S))
                return answer

            client = BoardClient(await open_transport(url))
            await client.open()
            await client.power_on()
            truth = await ask(do="truth")
            assert truth["ok"]
            assert truth["joint_deg"] == pytest.approx([-60.0, 60.0, -60.0, 45.0, 0.0])
            assert (await ask(do="object", width_mm=30, mass_kg=0.4))["ok"]
            assert (await ask(do="fault", spec="stall:motor=waist"))["faults"] == ["stall"]
            assert (await ask(do="clear", name="stall"))["cleared"] is True
            assert (await ask(do="press", button="estop"))["ok"]
            await client.until(lambda: bool(client.of(FaultReport)))
            assert (await ask(do="status"))["state"] == "FAULT"
            assert (await ask(do="input", line="SWITCH_ROLL", active=True))["ok"]
            await until_answer(lambda: ask(do="truth"), lambda now: now["inputs"]["SWITCH_ROLL"] is True)  # type: ignore[index]
            for request, word in (
                ({"do": "dance"}, "truth"),
                ({"do": "press", "button": "nose"}, "no input"),
                ({"do": "press", "button": "SWITCH_ROLL"}, "no button"),
                ({"do": "fault", "spec": "stall:motor=nose"}, "left-wrist"),
                ({"do": "object"}, "width_mm"),
            ):
                answer = await ask(**request)
                assert answer["ok"] is False
                assert word in str(answer["error"])
            writer.write(b"not json\n")
            assert json.loads(await reader.readline())["ok"] is False
            writer.close()
            await client.transport.aclose()
            await control.aclose()
            assert not (tmp_path / "control").exists()

    asyncio.run(main())


def test_the_command_serves_a_pty_says_so_and_ends_cleanly_on_a_signal(tmp_path) -> None:
    link, vcd = tmp_path / "arm", tmp_path / "run.vcd"
    code = "from rm501_sim_board.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "--pty", str(link), "--preset", "real", "--seed", "4", "--vcd", str(vcd)],
        stdout=subprocess.PIPE,
        text=True,
    )

    async def main() -> None:
        client = BoardClient(await open_transport(str(link)))
        await client.open()
        await client.power_on()
        assert (await client.status()).power
        await client.transport.aclose()

    try:
        assert process.stdout is not None
        start = process.stdout.readline()
        assert str(link) in start
        assert "preset real, seed 4" in start
        asyncio.run(main())
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0
    assert "frames written" in out
    assert "ended after" in out
    assert not link.is_symlink()
    assert vcd.read_text().startswith("$comment rm501")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "choose where to listen"),
        (["--pty", "x", "--tcp", "localhost:1"], "choose where to listen"),
        (["--tcp", "nowhere"], "HOST:PORT"),
        (["--pty", "x", "--preset", "perfect"], "ideal, real, harsh"),
        (["--pty", "x", "--fault", "gremlins"], "list-faults"),
        (["--pty", "x", "--fault", "stall"], "motor=... must be given"),
        (["--pty", "x", "--vcd", "/no/such/folder/x.vcd"], "no folder"),
        (["--can", "nothing"], "slcan:LINK"),
    ],
)
def test_wrong_arguments_are_refused_with_a_remedy(arguments, text) -> None:
    result = CliRunner().invoke(command_line, arguments)
    assert result.exit_code in (1, 2)
    assert text in result.output


def test_a_recording_that_could_not_be_written_is_refused_at_the_start(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    for option, file in (("--vcd", tmp_path), ("--trace", blocked / "below.npz"), ("--vcd", Path("/proc/run.vcd"))):
        result = CliRunner().invoke(command_line, ["--pty", str(tmp_path / "board"), option, str(file)])
        assert result.exit_code == 2
        assert str(file) in result.output
