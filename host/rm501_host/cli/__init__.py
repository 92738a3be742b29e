"""The command line `rm501-host`."""

from rm501_host.cli.main import main

__all__ = ["main"]
