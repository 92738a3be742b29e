"""Questions to the person at the arm, while the event loop goes on: the daemon's messages are read meanwhile, and
Ctrl-C ends the wait at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from typing import Protocol

import click

from rm501_host.errors import StoppedError


class Terminal(Protocol):
    """Who talks to the person."""

    def say(self, text: str) -> None:
        """Show a line."""
        ...

    async def ask(self, question: str, answers: tuple[str, ...]) -> str:
        """Ask until one of `answers` is given."""
        ...

    async def wait(self, text: str) -> None:
        """Wait until the person says go on."""
        ...


class Console:
    """Standard input and output."""

    def say(self, text: str) -> None:
        """Show a line."""
        click.echo(text)

    async def ask(self, question: str, answers: tuple[str, ...]) -> str:
        """Ask until one of `answers` is given; a beginning that fits only one of them will do. Raises StoppedError at
        the end of the input.
        """
        while True:
            given = await self._line(f"{question} ({', '.join(answers)}): ")
            found = [answer for answer in answers if answer == given] or [
                answer for answer in answers if given and answer.startswith(given)
            ]
            if len(found) == 1:
                return found[0]
            self.say(f"  {given!r} is none of {', '.join(answers)}")

    async def wait(self, text: str) -> None:
        """Wait for the Enter key."""
        await self._line(f"{text} Press Enter ")

    async def _line(self, prompt: str) -> str:
        click.echo(prompt, nl=False)
        line = await _read_line()
        if not line:
            raise StoppedError("the input ended before the last answer; nothing was written, begin again")
        return line.strip().lower()


async def _read_line() -> str:
    """The next line of standard input, empty at its end."""
    loop = asyncio.get_running_loop()
    ready = asyncio.Event()
    try:
        loop.add_reader(sys.stdin.fileno(), ready.set)
    except (NotImplementedError, OSError, ValueError):
        # no descriptor that can be watched: a file, or a system whose loop watches sockets only
        return await asyncio.to_thread(sys.stdin.readline)
    try:
        await ready.wait()
    finally:
        with contextlib.suppress(OSError, ValueError):
            loop.remove_reader(sys.stdin.fileno())
    return sys.stdin.readline()
