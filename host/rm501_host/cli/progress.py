"""How a run shows itself: a progress bar on a terminal, a line per phase elsewhere, nothing with --json."""

from __future__ import annotations

import contextlib
import linecache
import sys
import time
from collections.abc import Iterator

import click

from rm501_host.cli.context import CommandContext
from rm501_host.motion import Progress
from rm501_host.moves import Move
from rm501_host.planner.pieces import Action
from rm501_host.program_run import Watcher
from rm501_host.reading import tell_while_reading


class _Lines:
    """A line per phase, on standard error."""

    def phase(self, name: str) -> None:
        click.echo(f"{name} ...", err=True)

    def progress(self, progress: Progress) -> None:
        pass

    def message(self, text: str) -> None:
        click.echo(text, err=True)


class _Silent:
    """Messages alone, on standard error: standard output belongs to JSON."""

    def phase(self, name: str) -> None:
        pass

    def progress(self, progress: Progress) -> None:
        pass

    def message(self, text: str) -> None:
        click.echo(text, err=True)


def words_of_progress(context: CommandContext, doing: str, moves: Iterator[Move | Action]) -> Iterator[Move | Action]:
    """The moves; where reading them takes long, a line on standard error every few seconds, none with --json."""
    if context.json_output:
        return moves

    def tell(line: int, count: int) -> None:
        click.echo(f"{doing} line {line}, {count} moves so far ...", err=True)

    return tell_while_reading(moves, tell, time.perf_counter)  # noqa: TID251  # words for a person, nothing depends


@contextlib.contextmanager
def watcher_for(context: CommandContext) -> Iterator[Watcher]:
    """The way to show a run that suits the terminal and the options."""
    if context.json_output:
        yield _Silent()
    elif not sys.stdout.isatty():
        yield _Lines()
    else:
        yield from _bar()


def _bar() -> Iterator[Watcher]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    console = Console()
    columns = (
        TextColumn("{task.description:<16}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[block]}"),
    )
    with Bar(*columns, console=console) as bar:
        task = bar.add_task("starting", total=None, block="")

        class _OnTerminal:
            def phase(self, name: str) -> None:
                bar.update(task, description=name, completed=0, total=None, block="")

            def progress(self, progress: Progress) -> None:
                source = progress.source
                text = "" if source is None else linecache.getline(source.file, source.line).strip()
                block = "" if source is None else f"line {source.line}: {text[:40]}"
                total = max(1, progress.planned_frames)
                bar.update(task, completed=progress.played_frames, total=total, block=block)

            def message(self, text: str) -> None:
                console.print(text)

        yield _OnTerminal()
