"""Talking to a running daemon: an asyncio client, and the command line's commands on top of it."""

from rm501_host.client.client import DaemonClient, RemoteError, connect

__all__ = ["DaemonClient", "RemoteError", "connect"]
