"""`rm501-sim-board`: the emulated controller and arm as a bench instrument of its own."""

from __future__ import annotations

import asyncio
import tempfile
from pathlib import Path

import click

_HELP = """An emulated RM-501: controller board, driver boards, motors, arm, switches and hand.

Choose where it listens, what kind of arm hangs on it and what goes wrong. It runs in real time until Ctrl-C.

\b
  rm501-sim-board --pty /tmp/rm501
      then: rm501-host --port /tmp/rm501 serve       (home, jog, send ... talk to it)
  rm501-sim-board --tcp 127.0.0.1:5010 --preset real --seed 3
      then: rm501-host --port socket://127.0.0.1:5010 run program.ngc
  rm501-sim-board --can slcan:/tmp/rm501can
      then: rm501-host --port can:slcan:/tmp/rm501can run program.ngc
  rm501-sim-board --pty /tmp/rm501 --fault swap:line=elbow_select,with=waist_select --vcd wrong.vcd

Presets: ideal (motors follow at once, nothing is off), real (dynamics, friction, backlash, worn switches, an arm that
is not its drawing), harsh (worse in every respect).
"""
_FILE = click.Path(path_type=Path, dir_okay=False)


def _list_faults(ctx: click.Context, param: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        from rm501_sim_board.fault_injection import fault_table

        click.echo(fault_table())
        ctx.exit()


@click.command(
    help=_HELP,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "terminal_width": 110},
)
@click.option("--pty", type=click.Path(path_type=Path), metavar="LINK", help="Listen on a pseudo terminal under LINK.")
@click.option("--tcp", metavar="HOST:PORT", help="Listen on a TCP socket; port 0 takes a free one.")
@click.option("--can", metavar="URL", help="Listen on CAN: slcan:LINK (an adapter on a pty) or INTERFACE:CHANNEL.")
@click.option("--preset", default="ideal", show_default=True, metavar="NAME", help="ideal, real or harsh.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="All chance follows from it.")
@click.option("--pose", metavar="Q1,..,Q5", help="Joint angles at power-up, DH deg.  [default: -60,60,-60,45,0]")
@click.option("--fault", multiple=True, metavar="SPEC", help="Something that goes wrong; may be repeated.")
@click.option(
    "--list-faults", is_flag=True, is_eager=True, expose_value=False, callback=_list_faults, help="Show all faults."
)
@click.option(
    "--vcd", type=_FILE, metavar="FILE", help="At the end, write pins, lines and motors (GTKWave, PulseView)."
)
@click.option("--trace", type=_FILE, metavar="FILE", help="At the end, write the true motion as an npz.")
@click.option("--control", metavar="WHERE", help='Control socket, a path or HOST:PORT: JSON lines, try {"do":"truth"}.')
@click.option("--live", is_flag=True, help="Print a line of truth every second.")
@click.option("--baud", type=click.IntRange(0), default=250_000, show_default=True, help="Line speed; 0: no limit.")
@click.option(
    "--firmware",
    type=click.Choice(["fast", "reference"]),
    default="fast",
    show_default=True,
    help="Which model of the firmware runs.",
)
@click.version_option(package_name="rm501", prog_name="rm501-sim-board")
def main(
    pty: Path | None,
    tcp: str | None,
    can: str | None,
    preset: str,
    seed: int,
    pose: str | None,
    fault: tuple[str, ...],
    vcd: Path | None,
    trace: Path | None,
    control: str | None,
    live: bool,
    baud: int,
    firmware: str,
) -> None:
    """See `_HELP`."""
    # Imported here so that --help answers at once.
    from rm501_sim_board.emulator import EmulatorOptions
    from rm501_sim_board.errors import SimBoardError
    from rm501_sim_board.fault_spec import parse_fault
    from rm501_sim_board.presets import at_pose
    from rm501_sim_board.presets import preset as find_preset
    from rm501_sim_board.running import RunOptions
    from rm501_sim_board.serve import REAL_TIME_TICK_S, ServeOptions, serve

    if sum(where is not None for where in (pty, tcp, can)) != 1:
        raise click.UsageError("choose where to listen: --pty LINK, --tcp HOST:PORT or --can URL")
    for file in (vcd, trace):
        if file is not None:
            _require_writable(file)
    try:
        run = RunOptions(
            emulator=EmulatorOptions(
                parameters=at_pose(find_preset(preset), pose), seed=seed, firmware=firmware, packets=can is not None
            ),
            baud=None if can is not None else baud or None,
            tick_s=REAL_TIME_TICK_S,
            faults=tuple(parse_fault(text) for text in fault),
            vcd=vcd,
            trace=trace,
        )
        options = ServeOptions(
            run, pty=pty, tcp=None if tcp is None else _host_and_port(tcp), can=can, control=control, live=live
        )
        asyncio.run(serve(options, lambda text: click.echo(f"rm501-sim-board: {text}")))
    except SimBoardError as error:
        raise click.ClickException(str(error)) from error


def _require_writable(file: Path) -> None:
    """These files are written at the end: what cannot be made now would cost the whole recording."""
    folder = file.resolve().parent
    if not folder.is_dir():
        raise click.UsageError(f"{file}: there is no folder {folder}")
    try:
        if file.exists():
            with file.open("ab"):
                return
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise click.UsageError(f"{file}: cannot be written: {error.strerror or error}") from error


def _host_and_port(text: str) -> tuple[str, int]:
    host, separator, port = text.rpartition(":")
    if not separator or not port.isdigit() or int(port) > 65535:
        raise click.BadParameter(f"{text!r} is not HOST:PORT", param_hint="--tcp")
    return host.strip("[]") or "127.0.0.1", int(port)
