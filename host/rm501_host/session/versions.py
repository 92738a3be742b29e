"""Two versions of the protocol that do not fit each other, in words."""

from __future__ import annotations

from rm501_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, Identify


def refused_text(identify: Identify) -> str:
    """Why there is no session with the board that identified itself so, and which side to update."""
    if identify.major == PROTOCOL_MAJOR:
        return "the board answers but opens no session; reset it, then connect again"
    if identify.major > PROTOCOL_MAJOR:
        remedy = "update rm501 on this computer"
    else:
        remedy = f"load firmware that speaks protocol {PROTOCOL_MAJOR} onto the board"
    return (
        f"the board speaks protocol {identify.major}.{identify.minor}, this host {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; "
        f"they would misunderstand each other, so no session was opened and nothing moves: {remedy}"
    )
