"""What every command gets from the options before its name."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rm501_host.config import Config


@dataclass
class CommandContext:
    """Global options; the configuration is read when a command first asks for it."""

    config_path: Path | None
    port: str | None
    json_output: bool
    verbose: int

    @cached_property
    def config(self) -> Config:
        """The configuration of `--config`, or the packaged one; raises ConfigError."""
        from rm501_host.config import load_config

        return load_config(self.config_path)

    @property
    def port_url(self) -> str:
        """The port of `--port`, or the configuration's."""
        return self.port or self.config.link.port
