"""Why the machine was taken away, and how to get it back: what is trusted, what to do.

One event often shows itself several times, in an order that chance decides: a line that falls silent breaks a motion
off, lets the question where the arm stands run out of time, ends the session, and may end in a restarted board.
`Causes` keeps one cause of each rank until it is resolved and shows the one of the highest rank, so what an operator
reads does not depend on what was noticed first: what follows from something else ranks below it, and a board's fault,
which a reset has to name, above everything.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from rm501_host.errors import RefusedError
from rm501_host.session import ContradictionError, LinkLostError, SessionLostError
from rm501_protocol.faults import FAULT_TEXTS, FaultCode
from rm501_protocol.link_events import LossReason


class Rank(IntEnum):
    """From what is merely so, through what follows from something else, to what everything else follows from."""

    CONNECTING = 0
    STARTED = 1
    AFTER_RESET = 2
    POWERED_OFF = 3
    UNSETTLED = 4
    OPERATOR_STOP = 5
    SILENT = 6
    LINK_LOST = 7
    TAKEN_OVER = 8
    BOARD_RESTARTED = 9
    REFUSED_CONNECTION = 10
    BOARD_FAULT = 11


_ABOUT_CONNECTION = (
    Rank.CONNECTING,
    Rank.SILENT,
    Rank.LINK_LOST,
    Rank.TAKEN_OVER,
    Rank.BOARD_RESTARTED,
    Rank.REFUSED_CONNECTION,
)
_LOST = (Rank.LINK_LOST, Rank.TAKEN_OVER, Rank.BOARD_RESTARTED)


@dataclass(frozen=True, slots=True)
class Cause:
    """A reason in words, and the remedy in words."""

    text: str
    remedy: str
    rank: Rank
    back: str = ""
    """The remedy once the connection has come back, where that differs."""


_BACK = "the connection is back: look at the arm, reset, and home the joints that are not trusted"
STARTED = Cause("the daemon has started", "look at the arm, then reset", Rank.STARTED)
CONNECTING = Cause(
    "there is no connection to the board yet",
    "switch the board on and check the cable; it is tried again",
    Rank.CONNECTING,
)
OPERATOR_STOP = Cause(
    "stopped by an operator",
    "look at the arm, reset, and home the joints that are not trusted",
    Rank.OPERATOR_STOP,
)
POWERED_OFF = Cause(
    "motor power was switched off", "reset switches it on again; home what is not trusted", Rank.POWERED_OFF
)
AFTER_RESET = Cause("reset, motor power is off", "switch the motors on", Rank.AFTER_RESET)
BOARD_RESTARTED = Cause(
    "the board restarted and lost its position",
    "find out why (supply, cable), reset, home every joint",
    Rank.BOARD_RESTARTED,
)
_TAKEN_OVER = Cause(
    "the board restarted, or another program has opened a session with it",
    "let one program at a time use the board; look at the arm, then reset and home what is not trusted",
    Rank.TAKEN_OVER,
)


class Causes:
    """What is known to be wrong, at most one cause of each rank; CONNECTING at first."""

    def __init__(self) -> None:
        self._known: dict[Rank, Cause] = {}
        self.add(CONNECTING)

    @property
    def shown(self) -> Cause | None:
        """The cause of the highest rank, None when nothing is wrong. A fault that is known while the connection is gone
        is shown together with that, for without a connection nobody can reset it.
        """
        if not self._known:
            return None
        first = self._known[max(self._known)]
        lost = next((self._known[rank] for rank in reversed(_LOST) if rank in self._known), None)
        if first.rank is not Rank.BOARD_FAULT or lost is None:
            return first
        return Cause(f"{first.text}; and {lost.text}", f"{lost.remedy}; then: {first.remedy}", first.rank)

    @property
    def connection(self) -> Cause:
        """Why there is no connection to the board, where there is none."""
        return next((self._known[rank] for rank in reversed(_ABOUT_CONNECTION) if rank in self._known), CONNECTING)

    def add(self, cause: Cause) -> bool:
        """This is so, too; False when it was known already."""
        if self._known.get(cause.rank) == cause:
            return False
        self._known[cause.rank] = cause
        return True

    def clear(self) -> None:
        """An operator has looked at it and has reset: nothing is wrong."""
        self._known.clear()

    def connected(self, *, restarted: bool, fault: Cause | None) -> None:
        """A session is open. `restarted`: with another boot of the board than the last one. `fault`: the one that is
        latched. What can be asked now, and what has been put right, is over; why the connection was lost stays, with
        what is left to do.
        """
        for over in (Rank.CONNECTING, Rank.UNSETTLED, Rank.REFUSED_CONNECTION, Rank.BOARD_FAULT):
            self._known.pop(over, None)
        for rank, cause in self._known.items():
            if cause.back:
                self._known[rank] = replace(cause, remedy=cause.back, back="")
        if restarted:
            self.add(BOARD_RESTARTED)
        if fault is not None:
            self.add(fault)
            for explained in _LOST:
                self._known.pop(explained, None)
        if not self._known:
            self.add(STARTED)

    def not_connected(self, refused: str | None = None) -> None:
        """An attempt to connect failed: somebody answered and was `refused` for that reason, or nobody did."""
        self._known.pop(Rank.REFUSED_CONNECTION, None)
        self.add(CONNECTING)
        if refused is not None:
            self.add(refused_connection(refused))


def link_lost(error: Exception) -> Cause:
    """The connection is gone; an arm that moves holds on its path by itself."""
    if isinstance(error, SessionLostError):
        return BOARD_RESTARTED if error.loss is LossReason.BOARD_RESTARTED else _TAKEN_OVER
    if isinstance(error, ContradictionError):
        return Cause(
            error.reason,
            "its firmware or its memory is not sound: stop the arm, restart the board, and home every joint",
            Rank.LINK_LOST,
        )
    reason = error.reason if isinstance(error, LinkLostError) else str(error)
    return Cause(
        f"the connection to the board is lost: {reason}",
        "the arm holds on its path; restore the connection (it is tried again), look at the arm, then reset",
        Rank.LINK_LOST,
        _BACK,
    )


def silent(silence_s: float) -> Cause:
    """A motion broke off, and a board that did not answer could not say where that left it."""
    return Cause(
        f"the board did not answer for {silence_s:.0f} s while a motion broke off; where that has left the arm is "
        "not known",
        "the arm holds on its path; check the connection and the board's power, look at the arm, then reset, which "
        "asks the board",
        Rank.SILENT,
        _BACK,
    )


def unsettled(reason: str) -> Cause:
    """A motion broke off, and a board that answers did not say where that left it."""
    return Cause(
        f"where a motion that broke off has left the arm is not known: {reason}",
        "look at the arm, then reset, which asks the board",
        Rank.UNSETTLED,
    )


def require_fault(name: str | None) -> None:
    """Refuse a name that no fault has: RefusedError with those that there are."""
    names = [fault.name for fault in FaultCode if fault is not FaultCode.NONE]
    if name is not None and name.upper() not in names:
        raise RefusedError(f"there is no fault {name!r}; the faults are {', '.join(names)}")


def board_fault(fault: FaultCode) -> Cause:
    """A fault that the board latched."""
    text = FAULT_TEXTS.get(fault)
    if text is None:
        return Cause(
            f"board fault {int(fault)}", "see the board's documentation, then reset naming the fault", Rank.BOARD_FAULT
        )
    return Cause(f"{fault.name}: {text.cause}", f"{text.remedy} (reset --fault {fault.name})", Rank.BOARD_FAULT)


def refused_connection(reason: str) -> Cause:
    """Somebody answers, but motion with it is refused."""
    return Cause(
        f"the board cannot be used: {reason}",
        "put that right; the connection is tried again",
        Rank.REFUSED_CONNECTION,
    )
