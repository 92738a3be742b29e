"""`rm501-host import-ini FILE.ini [--out FILE.toml]`."""

from __future__ import annotations

import json
import tempfile
import tomllib
from importlib import resources
from pathlib import Path

import click

from rm501_host.cli.context import CommandContext
from rm501_host.config.loader import load_config
from rm501_host.ini_import.convert import RM501_JOINT_SIGNS, convert_ini
from rm501_host.ini_import.reader import IniError, parse_ini
from rm501_host.ini_import.toml_text import toml_text
from rm501_host.storage.atomic import write_atomic


@click.command("import-ini")
@click.argument("ini", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write the configuration here.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@click.option(
    "--signs",
    default=",".join(map(str, RM501_JOINT_SIGNS)),
    show_default=True,
    help="DH angle = sign x INI angle, joints 1 to 5.",
)
@click.pass_obj
def import_ini_command(context: CommandContext, ini: Path, out: Path | None, force: bool, signs: str) -> None:
    """Turn a LinuxCNC INI file into a configuration and account for every value."""
    try:
        text = ini.read_bytes().decode("utf-8")
    except UnicodeDecodeError as error:
        raise IniError(str(ini), None, "is not UTF-8 text", "save it as UTF-8") from error
    try:
        joint_signs = tuple(int(part) for part in signs.split(","))
    except ValueError as error:
        raise click.BadParameter("give five of 1 and -1, such as 1,-1,-1,-1,1", param_hint="--signs") from error
    if out is not None and out.exists() and not force:
        raise click.BadParameter(f"{out} exists; give --force to replace it", param_hint="--out")
    base = tomllib.loads((resources.files("rm501_host") / "data" / "rm501.toml").read_text("utf-8"))
    conversion = convert_ini(parse_ini(ini.name, text), base, joint_signs)
    result = toml_text(
        conversion.data,
        conversion.origins,
        f"Imported from {ini.name}. Values without a comment come from the packaged rm501.toml.\n"
        "Lengths mm, angles deg (DH angles), speeds mm/s and deg/s.",
    )
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / (out.name if out is not None else "imported.toml")
        trial.write_text(result, "utf-8")
        load_config(trial)
    if out is not None:
        write_atomic(out, result.encode())
    if context.json_output:
        findings = [
            {
                "line": finding.line,
                "place": finding.place,
                "text": finding.text,
                "outcome": finding.outcome.value,
                "key": finding.key,
                "note": finding.note,
            }
            for finding in conversion.findings
        ]
        click.echo(json.dumps({"out": None if out is None else str(out), "findings": findings, "toml": result}))
        return
    for finding in conversion.findings:
        click.echo(str(finding), err=out is None)
    if out is None:
        click.echo(result, nl=False)
    else:
        click.echo(f"{out}: written and checked")
