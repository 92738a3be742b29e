"""Stable names, waiting for a port that comes back, and a reconnect through both."""

import asyncio
import os
import pty
import tty
from pathlib import Path

import pytest

from rm501_host.transports import open_transport, port_watch, stable_path, wait_for_path
from tests.host.transports.test_contract import Collector


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
    async with asyncio.timeout(10), asyncio.TaskGroup() as group:
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
    async with asyncio.timeout(10), asyncio.TaskGroup() as group:
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
