"""Playing planned pieces on a board, with an exact mirror of where the arm is.

The stream turns pieces into segments (`rm501_host.segmenter`), hands them to the link as fast as the board has free
slots, starts motion once enough is queued, and waits for its end. It mirrors the board's integer arithmetic: after
every play `positions_q48` and `end_frame` are the board's own numbers, bit for bit, so the next segment starts
exactly where the last one ended, also after a trigger, a stop or a hold that was ended.

A board that runs low holds on the path by itself; the stream resumes it once the queue is filled again. Every other
hold is somebody's will and is left alone; the stream just waits.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice

from rm501_host.config import Config
from rm501_host.errors import StoppedError
from rm501_host.motion.offsets import PlayOffsets
from rm501_host.moves import Source
from rm501_host.planner import Piece
from rm501_host.segmenter import PlannedSegment, Segmenter
from rm501_host.session import BoardRefusedError, BoardSession, LinkLostError
from rm501_host.session.board_session import Notice
from rm501_host.session.fault_words import describe_fault, fault_text
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import BoardState, Edge, EndCause, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.messages import (
    ArmTrigger,
    DisarmTrigger,
    FaultReport,
    MotionEnded,
    Refused,
    Resume,
    SetPositions,
    SetPower,
    Start,
    Status,
    TriggerAction,
    TriggerReport,
)
from rm501_protocol.segment import FRACTION_BITS, end_positions_q48, steps_of

_BATCH = 8
"""Segments planned at a time away from the event loop: long enough to be worth a thread, short enough to stop soon.
"""
_POLL_S = 0.02
_BOARD_EVENTS = 32
"""Output and hand events that a board holds at once, over all queued segments (the firmware's ring of events)."""
_HOMING_TRIGGER = 0


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a play has come: motion frames played since its start, all that are planned so far, the source line."""

    played_frames: int
    planned_frames: int
    source: Source | None


class MotionStream:
    """Plays pieces on the board of `session`; `prepare` first. One play at a time.

    `someone_resumes`: whether a hold that only a user may end is waited out; without a user there it ends the play.
    """

    def __init__(self, session: BoardSession, config: Config, *, someone_resumes: bool = True) -> None:
        self._session = session
        self._someone_resumes = someone_resumes
        self._config = config
        self._loop = asyncio.get_running_loop()
        self.positions_q48: tuple[int, ...] = ()
        """Exact commanded positions of all motors where the queue ends, in 2^-48 step."""
        self.end_frame = 0
        """Motion frame at which the queue ends, never wrapping."""
        self.offsets = PlayOffsets()
        """How much of the positions is play taken up."""
        self._ended: MotionEnded | None = None
        self._fault: FaultReport | None = None
        self._refused: Refused | None = None
        self._trigger: TriggerReport | None = None
        self._sources: deque[tuple[int, Source | None]] = deque()
        self._event_frames: deque[int] = deque()
        self._remove_listener = session.add_listener(self._listen)

    @property
    def positions_steps(self) -> tuple[int, ...]:
        """Step counts of all motors where the queue ends."""
        return tuple(steps_of(position) for position in self.positions_q48)

    @property
    def inputs(self) -> int:
        """Debounced inputs of the newest status, a bit per `InputId`."""
        status = self._session.status
        return 0 if status is None else status.inputs

    async def prepare(self) -> None:
        """Take over a board at rest: motor power on, mirror set to its positions.

        Raises StoppedError when a fault is latched or the arm is held, BoardRefusedError when power is refused.
        """
        status = await self._session.refresh_status()
        if status.state is BoardState.FAULT:
            raise StoppedError(f"a fault is latched: {fault_text(status.fault)}")
        if status.state not in (BoardState.IDLE, BoardState.READY):
            raise StoppedError(
                f"the board is {status.state.name} (hold cause {status.hold_cause.name}): "
                "resume or stop what it is doing, then connect again"
            )
        if not status.power:
            status = await self._session.command(
                SetPower(True), lambda now: now.power and now.state is BoardState.READY
            )
        if status.trusted_mask:
            # the board may stand a fraction of a step beyond its count: setting the count makes both exact
            trusted = status.trusted_mask
            await self._session.command(
                SetPositions(trusted, status.positions_steps), lambda now: now.trusted_mask & trusted == trusted
            )
        self.positions_q48 = tuple(steps << FRACTION_BITS for steps in status.positions_steps)
        self.end_frame = self._session.motion_frames.value

    async def set_positions(self, steps: Mapping[int, int]) -> None:
        """Define and trust the positions of some motors, at rest; raises BoardRefusedError."""
        positions = list(self.positions_steps)
        mask = 0
        for motor, count in steps.items():
            positions[motor] = count
            mask |= 1 << motor
        message = SetPositions(mask, tuple(positions))
        await self._session.command(message, lambda status: status.trusted_mask & mask == mask)
        exact = list(self.positions_q48)
        for motor, count in steps.items():
            exact[motor] = count << FRACTION_BITS
        self.positions_q48 = tuple(exact)

    async def play(
        self,
        pieces: Iterable[Piece],
        on_progress: Callable[[Progress], None] | None = None,
        *,
        flags: SegmentFlag = SegmentFlag.NONE,
        on_segment: Callable[[PlannedSegment], None] | None = None,
    ) -> None:
        """Play to the end and come to rest there, every segment with `flags` on top of its own.

        `on_segment` is told of every segment that is sent.

        Raises StoppedError when motion ended before its time, BoardRefusedError when the board refused a segment.
        """
        await self._run(pieces, on_progress, until_trigger=False, flags=flags, on_segment=on_segment)

    async def play_until(self, pieces: Iterable[Piece], switch: InputId, edge: Edge) -> TriggerReport | None:
        """Play until `switch` shows `edge`, then ramp to a stop on the path; None when the pieces ended before.

        The rest of the pieces is dropped and the mirror set to where the arm stopped.
        """
        self._trigger = None
        self._session.post(ArmTrigger(_HOMING_TRIGGER, switch, edge, TriggerAction.LATCH_AND_STOP, level=True))
        await self._run(pieces, None, until_trigger=True)
        if self._trigger is None:
            self._session.post(DisarmTrigger(_HOMING_TRIGGER))
        return self._trigger

    def detach(self) -> None:
        """Stop listening to the session."""
        self._remove_listener()

    # ---------------------------------------------------------------------------------- the one loop of a play

    async def _run(
        self,
        pieces: Iterable[Piece],
        on_progress: Callable[[Progress], None] | None,
        *,
        until_trigger: bool,
        flags: SegmentFlag = SegmentFlag.NONE,
        on_segment: Callable[[PlannedSegment], None] | None = None,
    ) -> None:
        session = self._session
        self._ended = self._fault = self._refused = None
        self._sources.clear()
        self._event_frames.clear()
        first_frame = self.end_frame
        source = iter(Segmenter(self._config, self.positions_q48, self.end_frame, self.offsets.law).segments(pieces))
        waiting: deque[PlannedSegment] = deque()
        exhausted = started = moved = False
        while True:
            session_failure = session.failure
            if session_failure is not None:
                raise session_failure
            if self._interrupted(until_trigger):
                return
            if not exhausted and len(waiting) < _BATCH:
                batch = await self._loop.run_in_executor(None, list, islice(source, _BATCH))
                exhausted = not batch
                waiting.extend(batch)
            while waiting and self._room(waiting) > 0:
                planned = waiting.popleft()
                segment = planned.segment
                session.post(replace(segment, flags=segment.flags | flags) if flags else segment)
                moved = True
                if on_segment is not None:
                    on_segment(planned)
                self._take(planned)
                await asyncio.sleep(0)
            filled = exhausted and not waiting
            if not started and moved and (filled or self._room(waiting) <= 0):
                session.post(Start())
                started = True
            self._give_up_on_a_lost_link()
            self._resume_after_low_water(filled or self._room(waiting) <= 0)
            if on_progress is not None:
                on_progress(self._progress(first_frame))
            if filled and self._at_rest_at_the_end(moved):
                return
            if filled or self._room(waiting) <= 0:
                await asyncio.sleep(_POLL_S)

    def _room(self, waiting: deque[PlannedSegment]) -> int:
        """Segments that the board will have room for once what the link holds has arrived; never more than its queue
        has slots, whatever it says, and none while its queue of events has no room for those of the next one.
        """
        if waiting and waiting[0].segment.events:
            played = self._session.motion_frames.value
            while self._event_frames and self._event_frames[0] < played:
                self._event_frames.popleft()
            if len(self._event_frames) + len(waiting[0].segment.events) > _BOARD_EVENTS:
                return 0
        link = self._session.link
        slots = link.identify.queue_depth if link.identify is not None else 0
        return min(link.segment_credit, slots) - link.pending

    def _take(self, planned: PlannedSegment) -> None:
        segment = planned.segment
        self.positions_q48 = end_positions_q48(self.positions_q48, segment)
        self.end_frame += segment.length_frames
        self.offsets.add(planned)
        self._sources.append((self.end_frame, planned.source))
        self._event_frames.extend(planned.start_frame + event.offset_frames for event in segment.events)

    def _interrupted(self, until_trigger: bool) -> bool:
        """Whether motion ended early as it should (a trigger); raises when it ended as it should not."""
        if self._fault is not None:
            raise StoppedError(f"the board stopped the arm{self._where()}: {describe_fault(self._fault)}")
        if self._refused is not None:
            raise BoardRefusedError(self._refused)
        if self._ended is None:
            return False
        self.positions_q48 = self._ended.positions_q48
        self.end_frame = self._session.motion_frames.extend(self._ended.motion_frame)
        self.offsets.end_at(self.end_frame)
        if until_trigger and self._ended.cause is EndCause.TRIGGER and self._trigger is not None:
            state = None if self._session.status is None else self._session.status.state
            if state in (BoardState.BOOT, BoardState.IDLE):
                raise StoppedError(
                    f"stopped{self._where()} while the arm came to rest at a switch; reset the board, then start again"
                )
            return state is BoardState.READY
        if self._ended.cause is EndCause.TRIGGER:
            return False
        raise StoppedError(
            f"motion ended by {self._ended.cause.name}{self._where()}; the arm stands on its path; "
            "look at the status, reset, and start again"
        )

    def _give_up_on_a_lost_link(self) -> None:
        if self._someone_resumes:
            return
        status = self._session.status
        where = self._where()
        if self._session.link_silent:
            raise LinkLostError(
                f"the board has been silent for a second{where}; a moving arm holds on its path by itself, motors on; "
                "check the cable and the board, then look at the status before you home or run again"
            )
        if status is not None and status.state is BoardState.HELD and status.hold_cause is HoldCause.LINK_LOST:
            raise StoppedError(
                f"the link was lost for a while{where}; the arm holds on its path, its position is trusted; "
                "stop and reset the board, then run again"
            )

    def _at_rest_at_the_end(self, moved: bool) -> bool:
        status = self._session.status
        if status is None or status.state is not BoardState.READY:
            return False
        if not moved:
            return True
        return status.queue_used == 0 and self._session.motion_frames.value == self.end_frame

    def _resume_after_low_water(self, filled: bool) -> None:
        status = self._session.status
        if (
            filled
            and status is not None
            and status.state is BoardState.HELD
            and status.hold_cause is HoldCause.LOW_WATER
            and not self._session.link.pending
        ):
            self._session.post(Resume(ResumeCause.REFILLED))
            self._session.status = None

    def _where(self) -> str:
        """ " in FILE:LINE" where that is known."""
        place = self._progress(0).source
        return f" in {place}" if place is not None and place.line else ""

    def _progress(self, first_frame: int) -> Progress:
        played = self._session.motion_frames.value
        while len(self._sources) > 1 and self._sources[0][0] <= played:
            self._sources.popleft()
        source = self._sources[0][1] if self._sources else None
        return Progress(max(0, played - first_frame), self.end_frame - first_frame, source)

    def _listen(self, notice: Notice) -> None:
        match notice:
            case MotionEnded():
                self._ended = notice
            case FaultReport():
                self._fault = notice
            case Refused():
                # those that follow a refused segment are refused for the gap it left: the first one tells why
                self._refused = self._refused or notice
            case TriggerReport():
                self._trigger = notice
            case Status():
                pass
            case _:
                pass
