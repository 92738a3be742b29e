"""What a link tells its user, from `next_event`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from .declaration import Message
from .messages import Hello, Identify

__all__ = [
    "Event",
    "GenerationAdvanced",
    "LinkHeard",
    "LinkNoisy",
    "LinkSilent",
    "LossReason",
    "Received",
    "SessionLost",
    "SessionOpened",
    "SessionRefused",
    "StopAcknowledged",
    "StopKind",
    "StopReceived",
    "Undecodable",
]


class StopKind(Enum):
    """Which stop."""

    STOP = "stop"
    KILL = "kill"


class LossReason(Enum):
    """Why a session ended."""

    BOARD_RESTARTED = "the board has no session: it restarted"
    EPOCH_CHANGED = "the board opened a session with somebody else, or restarted and did"


@dataclass(frozen=True, slots=True)
class Received:
    """A message arrived; sequenced ones exactly once and in order within one session and stop generation."""

    message: Message
    sequence: int | None
    """None for a message that is not sequenced."""


@dataclass(frozen=True, slots=True)
class Undecodable:
    """A sequenced packet arrived intact, in order, and means nothing here; the board answers Refused."""

    message_id: int
    sequence: int
    reason: str


@dataclass(frozen=True, slots=True)
class SessionOpened:
    """A session began: on the host with the board's Identify, on the board with the host's Hello."""

    epoch: int
    identify: Identify | None = None
    hello: Hello | None = None


@dataclass(frozen=True, slots=True)
class SessionRefused:
    """Host only: the board opened no session, or one that this host cannot understand; `identify` has its version. The
    link is closed and sends nothing any more, stops excepted.
    """

    identify: Identify


@dataclass(frozen=True, slots=True)
class SessionLost:
    """Host only: the session is over. What it had sent and not seen acknowledged may or may not have been executed."""

    reason: LossReason
    dropped: tuple[Message, ...]


@dataclass(frozen=True, slots=True)
class StopReceived:
    """Board only: stop now. Everything received before and not yet fetched from the link is gone already."""

    kind: StopKind
    generation: int


@dataclass(frozen=True, slots=True)
class StopAcknowledged:
    """Host only: the board has executed the stop; messages sent from now on belong to `generation`."""

    kind: StopKind
    generation: int


@dataclass(frozen=True, slots=True)
class GenerationAdvanced:
    """Host only: the board stopped on its own and refuses what was in flight; `dropped` lists what it has not
    acknowledged.
    """

    generation: int
    dropped: tuple[Message, ...]


@dataclass(frozen=True, slots=True)
class LinkSilent:
    """Host only: nothing of this session arrived for `silent_us`."""

    silent_us: int


@dataclass(frozen=True, slots=True)
class LinkHeard:
    """Host only: the board is heard again after a silence of `silent_us`, the session still the same."""

    silent_us: int


@dataclass(frozen=True, slots=True)
class LinkNoisy:
    """Host only: of the last `frames` frames, `bad_frames` were broken, more than one in a hundred: look at the
    cable.
    """

    bad_frames: int
    frames: int


Event = (
    Received
    | Undecodable
    | SessionOpened
    | SessionRefused
    | SessionLost
    | StopReceived
    | StopAcknowledged
    | GenerationAdvanced
    | LinkSilent
    | LinkHeard
    | LinkNoisy
)
