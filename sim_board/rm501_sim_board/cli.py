"""`rm501-sim-board`: the emulated controller and arm as a bench instrument of its own."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

_HELP = """An emulated RM-501: controller board, driver boards, motors, arm, switches and hand.

Choose where it listens, what kind of arm hangs on it and what goes wrong. It runs in real time until Ctrl-C.

\b
  rm501-sim-board --pty /tmp/rm501                  then: rm501-host --port /tmp/rm501 ...
  rm501-sim-board --tcp 127.0.0.1:5010 --preset real --seed 3
"""


@click.command(help=_HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.option(
    "--pty", type=click.Path(path_type=Path), metavar="LINK", help="Listen on a pseudo terminal, found under LINK."
)
@click.option("--tcp", metavar="HOST:PORT", help="Listen on a TCP socket; port 0 takes a free one.")
@click.option(
    "--preset",
    default="ideal",
    show_default=True,
    metavar="NAME",
    help="What hangs on the board: ideal, real or harsh.",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Everything random repeats with the seed."
)
@click.option(
    "--baud", type=click.IntRange(0), default=250_000, show_default=True, help="Line speed; 0: bytes take no time."
)
@click.option(
    "--firmware",
    type=click.Choice(["fast", "reference"]),
    default="fast",
    show_default=True,
    help="Which model of the firmware runs.",
)
@click.option(
    "--vcd",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="At the end, write all pins, lines and motors as a VCD.",
)
@click.option(
    "--trace",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="At the end, write the true motion as an npz.",
)
@click.version_option(package_name="rm501", prog_name="rm501-sim-board")
def main(
    pty: Path | None,
    tcp: str | None,
    preset: str,
    seed: int,
    baud: int,
    firmware: str,
    vcd: Path | None,
    trace: Path | None,
) -> None:
    """See `_HELP`."""
    # Imported here so that --help answers at once.
    from rm501_sim_board.emulator import EmulatorOptions
    from rm501_sim_board.errors import SimBoardError
    from rm501_sim_board.presets import preset as find_preset
    from rm501_sim_board.serve import ServeOptions, serve

    if (pty is None) == (tcp is None):
        raise click.UsageError("choose where to listen: --pty LINK or --tcp HOST:PORT")
    try:
        options = ServeOptions(
            emulator=EmulatorOptions(parameters=find_preset(preset), seed=seed, firmware=firmware),
            pty=pty,
            tcp=None if tcp is None else _host_and_port(tcp),
            baud=baud or None,
            vcd=vcd,
            trace=trace,
        )
        asyncio.run(serve(options, click.echo))
    except SimBoardError as error:
        raise click.ClickException(str(error)) from error


def _host_and_port(text: str) -> tuple[str, int]:
    host, separator, port = text.rpartition(":")
    if not separator or not port.isdigit() or int(port) > 65535:
        raise click.BadParameter(f"{text!r} is not HOST:PORT", param_hint="--tcp")
    return host.strip("[]") or "127.0.0.1", int(port)
