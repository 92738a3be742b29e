"""One play: pieces become segments and go to the board as fast as it has free slots, until the arm rests at their end.

A board that runs low holds on the path by itself; the play resumes it once the queue is filled again. Every other hold
is somebody's will and is left alone; the play just waits. While it is held the play can be broken off: the queue is
dropped and the arm stands where it is, on its path.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice

from rm501_host.config import Config
from rm501_host.errors import StoppedError
from rm501_host.motion.mirror import Mirror
from rm501_host.motion.reports import Reports
from rm501_host.motion.respeeding import (
    BATCH,
    FIRST_BATCH,
    PLANNING_SHARES,
    Respeedable,
    Takeover,
    earliest_cut,
    longest_frames,
    prepared,
    takeover_place,
)
from rm501_host.moves import Source
from rm501_host.planner import Piece, PlanError
from rm501_host.segmenter import PlannedSegment, Segmenter
from rm501_host.session import BoardRefusedError, BoardSession, LinkLostError
from rm501_host.session.fault_words import describe_fault
from rm501_protocol.declaration import Message
from rm501_protocol.enums import BoardState, EndCause, HandState, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.faults import RefusalReason
from rm501_protocol.messages import Hold, Resume, Start, Truncate
from rm501_protocol.segment import MAX_LENGTH_FRAMES
from rm501_protocol.segment_message import Segment

_POLL_S = 0.02
_AHEAD_S = 0.15
"""How far ahead a progress shows what will be played: further than the next one comes."""
_FRAME_MASK = 0xFFFFFFFF
_HAND_MOVES = (HandState.OPENING, HandState.CLOSING)
_TOO_LATE = (
    "this computer or the line stood still for more than a second before the motion began; nobody expects it any more, "
    "so nothing moved: look at the arm, then start it again"
)
_REFUSED_ON_THE_WAY = "; the arm comes to rest on its path: look at it, then start again"
_TOO_SLOW = "the arm had passed the place before the new plan or its cut was there; this computer or the line is busy"


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a play has come: motion frames played since its start, all that are planned so far, the source line; the
    motion frame, and the segments that are played from there on for a moment.
    """

    played_frames: int
    planned_frames: int
    source: Source | None
    frame: int = 0
    ahead: tuple[PlannedSegment, ...] = ()


@dataclass(frozen=True, slots=True)
class BrokenOff:
    """Where a play was broken off: at a motion frame of a segment."""

    planned: PlannedSegment
    frame: int


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """`until_trigger`: a trigger ends the play as it should. `flags`: for every segment, on top of its own.
    `someone_resumes`: whether a hold that only a user may end is waited out. `on_segment` is told of every segment that
    is sent.
    """

    until_trigger: bool = False
    flags: SegmentFlag = SegmentFlag.NONE
    someone_resumes: bool = True
    on_progress: Callable[[Progress], None] | None = None
    on_segment: Callable[[PlannedSegment], None] | None = None


class Play:
    """Made for one `run`."""

    def __init__(
        self,
        session: BoardSession,
        config: Config,
        mirror: Mirror,
        reports: Reports,
        pieces: Iterable[Piece],
        options: PlayOptions,
    ) -> None:
        self._session = session
        self._config = config
        self._mirror = mirror
        self._reports = reports
        self._options = options
        self._frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
        self._live = pieces if isinstance(pieces, Respeedable) else None
        most_frames = MAX_LENGTH_FRAMES if self._live is None else longest_frames(config)
        segmenter = Segmenter(
            config, mirror.positions_q48, mirror.end_frame, mirror.offsets.law, most_frames=most_frames
        )
        self._source: Iterator[PlannedSegment] = iter(segmenter.segments(pieces))
        self._waiting: deque[PlannedSegment] = deque()
        self._is_exhausted = self._is_started = self._is_under_way = self._has_moved = False
        self._cut: Takeover | None = None
        self._attempts = 0
        self._break_off: asyncio.Future[bool] | None = None

    def break_off(self) -> asyncio.Future[bool]:
        """Ask for an end right here while the arm is held; the result tells whether it came to that."""
        if self._break_off is None:
            self._break_off = asyncio.get_running_loop().create_future()
        return self._break_off

    async def run(self) -> BrokenOff | None:
        """Play to the end; gives where it was broken off instead, if it was."""
        try:
            return await self._run()
        finally:
            if self._break_off is not None and not self._break_off.done():
                self._break_off.set_result(False)

    async def _run(self) -> BrokenOff | None:
        loop = asyncio.get_running_loop()
        options = self._options
        first_frame = self._mirror.end_frame
        while True:
            failure = self._session.failure
            if failure is not None:
                raise failure
            await self._begin_again_after_a_hold()
            if self._interrupted():
                return None
            if self._break_off is not None and (halt := await self._try_break_off(self._break_off)) is not None:
                return halt
            if self._live is not None:
                await self._respeed(self._live)
            if not self._is_exhausted and len(self._waiting) < BATCH and self._cut is None:
                size = BATCH if self._is_started else FIRST_BATCH
                batch = await loop.run_in_executor(None, list, islice(self._source, size))
                self._is_exhausted = not batch
                self._waiting.extend(batch)
            while self._waiting and self._cut is None and self._room() > 0:
                self._send(self._waiting.popleft())
                await asyncio.sleep(0)
            is_filled = self._is_exhausted and not self._waiting
            is_full = is_filled or self._room() <= 0
            if not self._is_started and self._has_moved and (is_full or self._may_begin()) and not self._is_held():
                if self._session.has_stalled:
                    raise StoppedError(_TOO_LATE)
                self._session.post(Start())
                self._is_started = True
            self._hold_what_begins_late()
            self._give_up_on_a_lost_link()
            if self._cut is None:
                self._resume_after_low_water(is_full)
            if options.on_progress is not None:
                options.on_progress(self.progress(first_frame))
            if is_filled and self._cut is None and self._is_at_rest_at_the_end():
                return None
            if is_full or self._cut is not None:
                await asyncio.sleep(_POLL_S)

    def _may_begin(self) -> bool:
        """Whether what is queued outlasts the stall budget and still lets the board stop on the path then."""
        budget_s = self._config.planner.stall_budget_s
        return earliest_cut(self._config, self._mirror.sent, self._mirror.sent[0].start_frame, budget_s) is not None

    async def _begin_again_after_a_hold(self) -> None:
        """A hold may meet the board before the start does, which it then refuses: the motion begins once somebody
        resumes.
        """
        refused = self._reports.refused
        if (
            refused is None
            or refused.message_id != Start.ID
            or refused.reason is not RefusalReason.WRONG_STATE
            or not self._options.someone_resumes
            or self._reports.ended is not None
        ):
            return
        status = await self._session.refresh_status()
        if status.state in (BoardState.HELD, BoardState.READY) and self._reports.ended is None:
            self._reports.refused = None
            self._is_started = self._is_under_way = False

    def _is_held(self) -> bool:
        status = self._session.status
        return status is not None and status.state is BoardState.HELD and self._options.someone_resumes

    def _hold_what_begins_late(self) -> None:
        """A start that is still on its way when the line falls silent would be obeyed whenever the line is back."""
        if self._is_started and not self._is_under_way:
            status = self._session.status
            if status is not None and status.state is not BoardState.READY:
                self._is_under_way = True
            elif self._session.link_silent or self._session.has_stalled:
                self._is_under_way = True
                if self._session.link.take_back(lambda message: isinstance(message, Start)):
                    raise StoppedError(_TOO_LATE)
                self._session.post(Hold())

    # ------------------------------------------------------------------------------------------ segments

    def _room(self) -> int:
        """Segments that the board will have room for once what the link holds has arrived; never more than its queue
        has slots, whatever it says, and none while its queue of events has no room for those of the next one.
        """
        if self._waiting and not self._mirror.takes_events_of(self._waiting[0], self._session.motion_frames.value):
            return 0
        link = self._session.link
        slots = link.identify.queue_depth if link.identify is not None else 0
        return min(link.segment_credit, slots) - link.pending

    def _send(self, planned: PlannedSegment) -> None:
        segment, flags = planned.segment, self._options.flags
        self._session.post(replace(segment, flags=segment.flags | flags) if flags else segment)
        self._has_moved = True
        if self._options.on_segment is not None:
            self._options.on_segment(planned)
        self._mirror.add(planned)

    def _take_back_unsent(self) -> None:
        """Segments that the link has not sent yet wait here again."""
        unsent = self._session.link.take_back(_is_segment)
        if unsent:
            first = self._mirror.sent[-len(unsent)].start_frame
            self._waiting.extendleft(reversed(self._mirror.back_to(first)))

    # ------------------------------------------------------------------------------------------ another law

    async def _respeed(self, live: Respeedable) -> None:
        """One step towards another law, if one is wanted."""
        if self._cut is not None:
            self._answer(live, self._cut)
            return
        if not self._is_started or not live.is_respeed_wanted:
            return
        place = takeover_place(
            self._config, live, self._mirror, self._waiting, self._session.motion_frames.value, self._attempts
        )
        if place is None:
            return
        at, before = place
        loop = asyncio.get_running_loop()
        try:
            takeover = await loop.run_in_executor(None, prepared, self._config, live, at, before)
        except PlanError as error:
            # what is being played is legal, and goes on
            live.discard(str(error), for_good=True)
            return
        earliest = earliest_cut(self._config, [*self._mirror.sent, *self._waiting], self._session.motion_frames.value)
        if self._reports.ended is not None or earliest is None or at.start_frame < earliest:
            self._missed(live)
            return
        self._take_back_unsent()
        if self._mirror.end_frame <= at.start_frame:
            self._take_over(live, takeover)
            return
        self._reports.forget_truncate()
        self._session.post(Truncate(at.start_frame & _FRAME_MASK))
        self._cut = takeover

    def _answer(self, live: Respeedable, takeover: Takeover) -> None:
        """Look whether the board has cut its queue."""
        if self._reports.truncate_refused is not None:
            self._cut = None
            self._missed(live)
        elif (truncated := self._reports.truncated) is not None:
            end_frame = self._session.motion_frames.extend(truncated.end_frame)
            if end_frame > takeover.at.start_frame:
                raise StoppedError(
                    f"the board keeps its queue up to frame {end_frame}, asked was for {takeover.at.start_frame}; "
                    "the arm stops on its path; look at the status, reset, and start again"
                )
            self._waiting.extendleft(reversed(self._mirror.back_to(end_frame)))
            self._take_over(live, takeover)

    def _take_over(self, live: Respeedable, takeover: Takeover) -> None:
        frame = takeover.at.start_frame
        self._cut = None
        self._attempts = 0
        self._waiting = deque(planned for planned in self._waiting if planned.start_frame < frame)
        self._waiting.extend(takeover.first)
        self._source, self._is_exhausted = takeover.others, False
        live.adopt()

    def _missed(self, live: Respeedable) -> None:
        """Too late for that place: the old law goes on, the next attempt leaves more time."""
        self._attempts += 1
        live.discard(_TOO_SLOW, for_good=self._attempts >= len(PLANNING_SHARES))
        self._attempts %= len(PLANNING_SHARES)

    # ------------------------------------------------------------------------------------------ early ends

    async def _try_break_off(self, wanted: asyncio.Future[bool]) -> BrokenOff | None:
        """Drop the queue of a held board and say where the arm stands; None where it is not held (any more), and for
        now while the hand makes the rest of a stroke: the program expects the arm to wait for it.
        """
        status = self._session.status
        if self._cut is not None:
            return None
        planned = None
        if status is not None and status.state is BoardState.HELD:
            frame = self._session.motion_frames.extend(status.motion_frame)
            planned = self._mirror.under_way(frame)
            if planned is not None and status.hand in _HAND_MOVES:
                return None
        if status is not None and planned is not None:
            self._take_back_unsent()
            self._reports.forget_truncate()
            self._session.post(Truncate(status.motion_frame))
            while self._reports.truncate_refused is None and self._session.failure is None:
                if self._reports.ended is not None:
                    if self._reports.ended.cause is not EndCause.TRUNCATED:
                        return None
                    frame = self._session.motion_frames.extend(self._reports.ended.motion_frame)
                    self._mirror.end_at(self._reports.ended.positions_q48, frame)
                    self._reports.forget()
                    wanted.set_result(True)
                    return BrokenOff(planned, frame)
                await asyncio.sleep(_POLL_S / 4)
        self._break_off = None
        wanted.set_result(False)
        return None

    def _interrupted(self) -> bool:
        """Whether motion ended early as it should (a trigger); raises when it ended as it should not."""
        reports = self._reports
        if reports.fault is not None:
            raise StoppedError(f"the board stopped the arm{self._where()}: {describe_fault(reports.fault)}")
        if reports.refused is not None:
            raise BoardRefusedError(reports.refused, self._where(), _REFUSED_ON_THE_WAY if self._is_under_way else "")
        if reports.ended is None:
            return False
        where = self._where()
        self._mirror.end_at(reports.ended.positions_q48, self._session.motion_frames.extend(reports.ended.motion_frame))
        if self._options.until_trigger and reports.ended.cause is EndCause.TRIGGER and reports.trigger is not None:
            state = None if self._session.status is None else self._session.status.state
            if state in (BoardState.BOOT, BoardState.IDLE):
                raise StoppedError(
                    f"stopped{where} while the arm came to rest at a switch; reset the board, then start again"
                )
            return state is BoardState.READY
        if reports.ended.cause is EndCause.TRIGGER:
            return False
        raise StoppedError(
            f"motion ended by {reports.ended.cause.name}{where}; the arm stands on its path; "
            "look at the status, reset, and start again"
        )

    def _give_up_on_a_lost_link(self) -> None:
        if self._options.someone_resumes:
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

    # ------------------------------------------------------------------------------------------ progress

    def _is_at_rest_at_the_end(self) -> bool:
        status = self._session.status
        if status is None or status.state is not BoardState.READY:
            return False
        if not self._has_moved:
            return True
        return status.queue_used == 0 and self._session.motion_frames.value == self._mirror.end_frame

    def _resume_after_low_water(self, is_full: bool) -> None:
        status = self._session.status
        if (
            is_full
            and status is not None
            and status.state is BoardState.HELD
            and status.hold_cause is HoldCause.LOW_WATER
            and not self._session.link.pending
        ):
            self._session.post(Resume(ResumeCause.REFILLED))
            self._session.status = None

    def _where(self) -> str:
        """ " in FILE:LINE" where that is known."""
        place = self.progress(0).source
        return f" in {place}" if place is not None and place.line else ""

    def progress(self, first_frame: int) -> Progress:
        """How far it has come since `first_frame`."""
        mirror = self._mirror
        frame = self._session.motion_frames.value
        mirror.forget_played(frame)
        source = mirror.sent[0].source if mirror.sent else None
        ahead = mirror.between(frame, frame + round(_AHEAD_S / self._frame_s))
        return Progress(max(0, frame - first_frame), mirror.end_frame - first_frame, source, frame, ahead)


def _is_segment(message: Message) -> bool:
    return isinstance(message, Segment)
