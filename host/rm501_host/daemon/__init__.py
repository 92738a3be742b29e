"""The daemon `rm501-host serve`: JSON-RPC 2.0 over a unix socket and WebSocket, in front of one machine."""
