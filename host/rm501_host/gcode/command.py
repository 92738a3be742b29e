"""`rm501-host interpret`: the canonical calls of a program, in the form of `rs274 -g` or as JSON lines."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rm501_host.gcode.interpreter import Interpreter


@click.command("interpret")
@click.argument("program", type=click.Path(exists=True, dir_okay=False, readable=True, path_type=Path))
@click.option("--tools", type=click.Path(exists=True, dir_okay=False, path_type=Path), help="Tool table file.")
@click.option(
    "--vars",
    "variables",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Variable file; read if it exists, written at the end.",
)
@click.option("--block-delete", is_flag=True, help="Skip blocks that begin with a slash.")
@click.option("--start-line", type=click.IntRange(min=1), default=1, show_default=True, help="Begin at this line.")
@click.option(
    "--subroutines",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    multiple=True,
    help="Folder with subroutine files; repeat for more. The program's and the current folder are always searched.",
)
@click.option(
    "--machine-units",
    type=click.Choice(["inch", "mm"]),
    default="inch",
    show_default=True,
    help="Unit of tool table, variable file and #5161 to #5390; inch is what rs274 uses.",
)
@click.pass_context
def interpret_command(
    ctx: click.Context,
    program: Path,
    tools: Path | None,
    variables: Path | None,
    block_delete: bool,
    start_line: int,
    subroutines: tuple[Path, ...],
    machine_units: str,
) -> None:
    """Print the canonical calls of PROGRAM, one a line; with --json one object a line."""
    from rm501_host.cli.outputs import require_writable
    from rm501_host.gcode.canon import Units
    from rm501_host.gcode.interpreter import Interpreter
    from rm501_host.gcode.settings import Settings
    from rm501_host.gcode.source import FileLines
    from rm501_host.gcode.tools import load_tool_table

    require_writable("--vars", variables)
    settings = Settings.as_peer(
        machine_units=Units.INCH if machine_units == "inch" else Units.MM,
        block_delete=block_delete,
        start_line=start_line,
        subroutine_path=(program.resolve().parent, *subroutines, Path.cwd()),
    )
    as_json = bool(getattr(ctx.obj, "json_output", False))
    source = FileLines.open(program)
    try:
        interpreter = Interpreter(
            source,
            settings,
            tools=None if tools is None else load_tool_table(tools),
            variables=variables if variables is not None and variables.exists() else None,
            on_warning=lambda warning: click.echo(str(warning), err=True),
        )
        try:
            _print_calls(interpreter, as_json)
        finally:
            if variables is not None:
                interpreter.save_parameters(variables)
    finally:
        source.close()


def _print_calls(interpreter: Interpreter, as_json: bool) -> None:
    from rm501_host.gcode.canon_format import CanonPrinter, to_json

    printer = CanonPrinter()
    write = sys.stdout.write
    for call in interpreter.calls():
        if as_json:
            write(json.dumps(to_json(call)) + "\n")
            continue
        for line in printer.lines(call):
            write(line.encode("utf-8", "replace").decode("utf-8") + "\n")
    sys.stdout.flush()
