"""`rm501-host`: global options, commands that are imported when they are called, and errors turned into exit codes.

`--help` has to answer at once, so a command's module is imported only when that command runs; its summary stands
here.
"""

from __future__ import annotations

import importlib
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from rm501_host.cli.context import CommandContext
from rm501_host.cli.exit_codes import ExitCode
from rm501_host.errors import NoBoardError, Rm501Error, StoppedError

_COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("rm501_host.cli.run:run_command", "Home the arm, run a program to its end, report."),
    "check": ("rm501_host.preflight.command:check_command", "Check a program without moving anything."),
    "interpret": ("rm501_host.gcode.command:interpret_command", "Print a program's canonical calls."),
    "plan": ("rm501_host.planner.command:plan_command", "Plan a program's time law without a board."),
    "serve": ("rm501_host.daemon.command:serve_command", "Own the arm and serve its API."),
    "status": ("rm501_host.client.commands:status_command", "Show the arm's state."),
    "monitor": ("rm501_host.client.commands:monitor_command", "Follow the arm's state."),
    "home": ("rm501_host.client.commands:home_command", "Home all joints, or those named."),
    "jog": ("rm501_host.client.commands:jog_command", "Move a joint or the tool by hand."),
    "mdi": ("rm501_host.client.commands:mdi_command", "Run one block of G-code."),
    "send": ("rm501_host.client.commands:send_command", "Run a program through the daemon."),
    "follow": ("rm501_host.client.follow:follow_command", "Follow a timed joint trajectory from a file."),
    "hold": ("rm501_host.client.commands:hold_command", "Hold on the path."),
    "override": ("rm501_host.client.path_commands:override_command", "Set the feed override, 0 to 200 %."),
    "back": ("rm501_host.client.path_commands:back_command", "Run a held program back along its path."),
    "resume": ("rm501_host.client.commands:resume_command", "Go on after a hold."),
    "stop": ("rm501_host.client.commands:stop_command", "Stop on the path, motors off."),
    "abort": ("rm501_host.client.commands:abort_command", "End the program at rest, motors on."),
    "limits": ("rm501_host.client.limits:limits_command", "Show or lower the limits in force."),
    "reset": ("rm501_host.client.commands:reset_command", "Clear a fault or a stop."),
    "gripper": ("rm501_host.client.commands:gripper_command", "Open or close the hand."),
    "teach": ("rm501_host.client.commands:teach_command", "Record, list and go to points."),
    "commission": ("rm501_host.commission.commands:commission_command", "Set up a real arm, step by step."),
    "verify": ("rm501_host.commission.commands:verify_command", "Touch the switches again, report lost steps."),
    "doctor": ("rm501_host.commission.commands:doctor_command", "Measure whether this computer is fit for it."),
    "check-config": ("rm501_host.cli.check_config:check_config_command", "Check a configuration file."),
    "import-ini": ("rm501_host.ini_import.command:import_ini_command", "Make a configuration of a LinuxCNC INI."),
    "workspace": ("rm501_host.kinematics.commands:workspace_command", "Draw what the arm can reach."),
    "export-urdf": ("rm501_host.kinematics.commands:export_urdf_command", "Write the arm as a URDF model."),
}


class _LazyGroup(click.Group):
    """A group whose commands are imported when they are needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        module_name, _, attribute = _COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module_name), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in _COMMANDS.items()])


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--config", "config_path", type=click.Path(path_type=Path), help="TOML file; default: packaged rm501.toml."
)
@click.option("--port", help="emu://[?preset=real&seed=1], /dev/tty..., socket://host:port, can:slcan:/dev/...")
@click.option("--json", "json_output", is_flag=True, help="JSON alone on standard output; logs go to standard error.")
@click.option("-v", "--verbose", count=True, help="Log more; twice: the wire too.")
@click.version_option(package_name="rm501")
@click.pass_context
def cli(ctx: click.Context, config_path: Path | None, port: str | None, json_output: bool, verbose: int) -> None:
    """Controller of the RM-501 arm: plans here, lets the board time the steps.

    Exit codes: 0 ok, 2 usage, 3 configuration, 4 no board, 5 refused, 6 stopped or fault, 130 interrupted.
    """
    logging.basicConfig(
        level=(logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)],
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
        stream=sys.stderr,
    )
    ctx.obj = CommandContext(config_path, port, json_output, verbose)


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point: run the command line and exit with a code of `ExitCode`."""
    raise SystemExit(run_command_line(arguments))


def run_command_line(arguments: Sequence[str] | None = None) -> ExitCode:
    """Run one command; every error that we know becomes a line on standard error and its exit code."""
    try:
        result = cli.main(args=arguments, prog_name="rm501-host", standalone_mode=False)
    except click.exceptions.Exit as exit_request:
        return ExitCode(exit_request.exit_code)
    except (click.Abort, KeyboardInterrupt):  # click turns Ctrl-C into Abort
        click.echo("interrupted", err=True)
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        # whoever read our output went away (`| head`); what is left in the buffer has nowhere to go either
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.OK
    except click.ClickException as error:
        error.show()
        return ExitCode.USAGE
    except Rm501Error as error:
        click.echo(f"rm501-host: {error}", err=True)
        return exit_code_of(error)
    except OSError as error:
        if error.filename is None:
            raise
        click.echo(f"rm501-host: {error.filename}: {error.strerror}; check the name and the folder's rights", err=True)
        return ExitCode.REFUSED
    return result if isinstance(result, ExitCode) else ExitCode.OK


def exit_code_of(error: Rm501Error) -> ExitCode:
    """The exit code that belongs to an error."""
    from rm501_host.config import ConfigError

    if isinstance(error, ConfigError):
        return ExitCode.CONFIG
    if isinstance(error, NoBoardError):
        return ExitCode.NO_BOARD
    if isinstance(error, StoppedError):
        return ExitCode.STOPPED
    return ExitCode.REFUSED
