"""Stable names, waiting for a port that comes back, and a reconnect through both."""

import asyncio
import os
import pty
import tty
from pathlib import Path

import pytest

from rm501_host.transports import PortError, SteadyPort, open_transport, port_watch, stable_path, wait_for_path
from tests.host.transports.test_contract import Collector
from tests.support.patience import PATIENCE_S


def test_a_device_is_known_by_the_name_that_it_keeps(tmp_path: Path) -> None:
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    device = tmp_path / "ttyUSB0"
    device.touch()
    other = tmp_path / "ttyUSB1"
    other.touch()
    (by_id / "usb-board").symlink_to(device)
    assert stable_path(str(device), by_id) == str(by_id / "usb-board")
    assert stable_path(str(other), by_id) == str(other)
    assert stable_path(str(tmp_path / "gone"), by_id) == str(tmp_path / "gone")
    assert stable_path(str(device), tmp_path / "no-such-folder") == str(device)


@pytest.mark.parametrize("inotify", [True, False])
async def test_waiting_ends_when_the_port_appears_also_in_a_new_folder(
    tmp_path: Path, inotify: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not inotify:
        monkeypatch.setattr(port_watch, "_watch", lambda folder: None)
        monkeypatch.setattr(port_watch, "_FALLBACK_S", 0.01)
    path = tmp_path / "serial" / "by-id" / "usb-board"
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
        waiting = group.create_task(wait_for_path(str(path)))
        await asyncio.sleep(0.02)
        assert not waiting.done()
        path.parent.mkdir(parents=True)
        await asyncio.sleep(0.02)
        assert not waiting.done()
        (path.parent / "another").touch()
        await asyncio.sleep(0.02)
        assert not waiting.done()
        path.touch()
        await waiting


async def test_a_board_that_was_unplugged_is_opened_again_by_its_stable_name(tmp_path: Path) -> None:
    name = tmp_path / "usb-board"

    def plug_in() -> tuple[int, int]:
        near, far = pty.openpty()
        tty.setraw(far)
        name.symlink_to(os.ttyname(far))
        return near, far

    near, far = plug_in()
    first = await open_transport(str(name))
    lost = Collector()
    first.start(lost)
    name.unlink()
    os.close(near)
    os.close(far)
    await lost.until(lambda: bool(lost.lost))
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
        waiting = group.create_task(wait_for_path(str(name)))
        await asyncio.sleep(0.02)
        near, far = plug_in()
        await waiting
    second = await open_transport(str(name))
    collector = Collector()
    second.start(collector)
    os.write(near, b"hello")
    await collector.until(lambda: bytes(collector.data) == b"hello")
    await second.aclose()
    os.close(near)
    os.close(far)


class PluggedIn:
    """A pty under a device name."""

    def __init__(self, device: Path) -> None:
        self.device = device
        self.near, self._far = pty.openpty()
        tty.setraw(self._far)
        device.symlink_to(os.ttyname(self._far))

    def unplug(self) -> None:
        self.device.unlink()
        os.close(self.near)
        os.close(self._far)


async def test_a_board_that_comes_back_under_another_number_is_found_and_no_other_is_taken_for_it(
    tmp_path: Path,
) -> None:
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    # the lasting name leads to the numbered one, as udev has it
    lasting = by_id / "usb-board"
    board = PluggedIn(tmp_path / "ttyUSB0")
    lasting.symlink_to(board.device)
    port = SteadyPort(f"{board.device}?baud=115200", by_id)
    first = await port.open()
    assert port.name == str(lasting)
    lost = Collector()
    first.start(lost)
    lasting.unlink()
    board.unplug()
    await lost.until(lambda: bool(lost.lost))
    stranger = PluggedIn(tmp_path / "ttyUSB0")  # another device gets the number that is free now
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
        opening = group.create_task(port.open())
        await asyncio.sleep(0.05)
        assert not opening.done()
        board = PluggedIn(tmp_path / "ttyUSB1")
        lasting.symlink_to(board.device)
        second = await opening
    collector = Collector()
    second.start(collector)
    os.write(stranger.near, b"wrong")
    os.write(board.near, b"right")
    await collector.until(lambda: bytes(collector.data) == b"right")
    assert second.bytes_per_second == 11_520
    await second.aclose()
    board.unplug()
    stranger.unplug()


async def test_a_port_that_never_was_there_is_refused_at_once_and_one_that_stays_away_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rm501_host.transports import steady_port

    monkeypatch.setattr(steady_port, "_PATIENCE_S", 0.05)
    port = SteadyPort(str(tmp_path / "ttyUSB0"))
    with pytest.raises(PortError, match="no such port"):
        await port.open()
    board = PluggedIn(tmp_path / "ttyUSB0")
    await (await port.open()).aclose()
    board.unplug()
    with pytest.raises(PortError, match="no such port"):
        await port.open()


async def test_other_kinds_of_ports_are_opened_as_they_are() -> None:
    port = SteadyPort("emu://?seed=5")
    transport = await port.open()
    assert port.name == "emu://"
    await transport.aclose()
    with pytest.raises(PortError, match="unknown kind of port"):
        await SteadyPort("nothing://x").open()
