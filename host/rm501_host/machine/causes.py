"""Why the machine was taken away, and how to get it back: what is trusted, what to do."""

from __future__ import annotations

from dataclasses import dataclass

from rm501_host.session.board_session import LinkLostError
from rm501_protocol.faults import FAULT_TEXTS, FaultCode


@dataclass(frozen=True, slots=True)
class Cause:
    """A reason in words, and the remedy in words."""

    text: str
    remedy: str


STARTED = Cause("the daemon has started", "look at the arm, then reset")
CONNECTING = Cause(
    "there is no connection to the board yet", "switch the board on and check the cable; it is tried again"
)
OPERATOR_STOP = Cause("stopped by an operator", "look at the arm, reset, and home the joints that are not trusted")
POWERED_OFF = Cause("motor power was switched off", "reset switches it on again; home what is not trusted")
AFTER_RESET = Cause("reset, motor power is off", "switch the motors on")
BOARD_RESET = Cause(
    "the board restarted and lost its position", "find out why (supply, cable), reset, home every joint"
)


def link_lost(error: Exception) -> Cause:
    """The connection is gone; the arm holds on its path by itself."""
    reason = error.reason if isinstance(error, LinkLostError) else str(error)
    return Cause(
        f"the connection to the board is lost: {reason}",
        "the arm holds on its path; restore the connection (it is tried again), look at the arm, then reset",
    )


def unsettled(reason: str) -> Cause:
    """A motion broke off, and the board did not say where that left it."""
    return Cause(
        f"where a motion that broke off has left the arm is not known: {reason}",
        "look at the arm, then reset, which asks the board",
    )


def board_fault(fault: FaultCode) -> Cause:
    """A fault that the board latched."""
    text = FAULT_TEXTS.get(fault)
    if text is None:
        return Cause(f"board fault {int(fault)}", "see the board's documentation, then reset naming the fault")
    return Cause(f"{fault.name}: {text.cause}", f"{text.remedy} (reset --fault {fault.name})")


def refused_connection(reason: str) -> Cause:
    """Somebody answers, but motion with it is refused."""
    return Cause(f"the board cannot be used: {reason}", "put that right; the connection is tried again")
