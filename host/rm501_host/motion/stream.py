"""Playing planned pieces on a board, with an exact mirror of where the arm is.

The stream outlives its plays (`motion.play`): after every one `positions_q48` and `end_frame` are the board's own
numbers, bit for bit, so the next segment starts exactly where the last one ended, also after a trigger, a stop or a
hold that was ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

from rm501_host.config import Config
from rm501_host.errors import StoppedError
from rm501_host.motion.mirror import Mirror
from rm501_host.motion.offsets import PlayOffsets
from rm501_host.motion.play import BrokenOff, Play, PlayOptions, Progress
from rm501_host.motion.reports import Reports
from rm501_host.planner import Piece
from rm501_host.segmenter import PlannedSegment
from rm501_host.session import BoardSession
from rm501_host.session.fault_words import fault_text
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import BoardState, Edge, SegmentFlag
from rm501_protocol.messages import (
    ArmTrigger,
    DisarmTrigger,
    MotionEnded,
    SetPositions,
    SetPower,
    TriggerAction,
    TriggerReport,
    Truncate,
)
from rm501_protocol.segment import FRACTION_BITS, steps_of

_HOMING_TRIGGER = 0


class MotionStream:
    """Plays pieces on the board of `session`; `prepare` first. One play at a time.

    `someone_resumes`: whether a hold that only a user may end is waited out; without a user there it ends the play.
    """

    def __init__(self, session: BoardSession, config: Config, *, someone_resumes: bool = True) -> None:
        self._session = session
        self._someone_resumes = someone_resumes
        self._config = config
        self._play: Play | None = None
        self._reports = Reports(session.real_frames)
        self.mirror = Mirror(config)
        self._remove_listener = session.add_listener(self._reports.listen)

    @property
    def positions_q48(self) -> tuple[int, ...]:
        """Exact commanded positions of all motors where the queue ends, in 2^-48 step."""
        return self.mirror.positions_q48

    @property
    def end_frame(self) -> int:
        """Motion frame at which the queue ends, never wrapping."""
        return self.mirror.end_frame

    @property
    def offsets(self) -> PlayOffsets:
        """How much of the positions is play taken up."""
        return self.mirror.offsets

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
        """Take over a board at rest: motor power on, mirror set to its positions. Motion that somebody queued and
        never started is dropped; it will not run.

        Raises StoppedError when a fault is latched or the arm is held, BoardRefusedError when power is refused.
        """
        await self._session.withdraw_motion()
        status = await self._session.refresh_status()
        if status.state is BoardState.FAULT:
            raise StoppedError(f"a fault is latched: {fault_text(status.fault)}")
        if status.state not in (BoardState.IDLE, BoardState.READY):
            raise StoppedError(
                f"the board is {status.state.name} (hold cause {status.hold_cause.name}): "
                "resume or stop what it is doing, then connect again"
            )
        if status.state is BoardState.READY and status.queue_used:
            # a line lost between the segments and their start: nobody will complete that motion
            status = await self._session.command(Truncate(status.motion_frame), lambda now: now.queue_used == 0)
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
        exact = tuple(steps << FRACTION_BITS for steps in status.positions_steps)
        self.mirror.stand(exact, self._session.motion_frames.value)
        self._reports.forget()

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
        self.mirror.stand(exact, self.end_frame)

    async def play(
        self,
        pieces: Iterable[Piece],
        on_progress: Callable[[Progress], None] | None = None,
        *,
        flags: SegmentFlag = SegmentFlag.NONE,
        on_segment: Callable[[PlannedSegment], None] | None = None,
    ) -> BrokenOff | None:
        """Play to the end and come to rest there, every segment with `flags` on top of its own.

        `on_segment` is told of every segment that is sent. Gives where the play was broken off (`break_off`), None at
        the end. Pieces that are a `Respeedable` may change their law on the way.

        Raises StoppedError when motion ended before its time, BoardRefusedError when the board refused a segment.
        """
        options = PlayOptions(
            flags=flags, someone_resumes=self._someone_resumes, on_progress=on_progress, on_segment=on_segment
        )
        return await self._run(pieces, options)

    async def play_until(self, pieces: Iterable[Piece], switch: InputId, edge: Edge) -> TriggerReport | None:
        """Play until `switch` shows `edge`, then ramp to a stop on the path; None when the pieces ended before.

        The rest of the pieces is dropped and the mirror set to where the arm stopped.
        """
        self._session.post(ArmTrigger(_HOMING_TRIGGER, switch, edge, TriggerAction.LATCH_AND_STOP, level=True))
        await self._run(pieces, PlayOptions(until_trigger=True, someone_resumes=self._someone_resumes))
        if self._reports.trigger is None:
            self._session.post(DisarmTrigger(_HOMING_TRIGGER))
        return self._reports.trigger

    def detach(self) -> None:
        """Stop listening to the session."""
        self._remove_listener()

    def motion_ended(self, ended: MotionEnded) -> bool:
        """Motion ended before its queue did: take over where. False for an end that is told late, when the positions
        were taken over already: nothing is taken from it.
        """
        if self._reports.is_late(ended):
            return False
        self.mirror.end_at(ended.positions_q48, self._session.motion_frames.extend(ended.motion_frame))
        return True

    def under_way(self) -> tuple[PlannedSegment, int] | None:
        """The segment that is being played, and the motion frame of the newest status; None where nothing is."""
        frame = self._session.motion_frames.value
        planned = None if self._play is None else self.mirror.under_way(frame)
        return None if planned is None else (planned, frame)

    async def break_off(self) -> bool:
        """End the play here, on its path, while the arm is held; False when it is not held or its play was over."""
        return self._play is not None and await self._play.break_off()

    async def _run(self, pieces: Iterable[Piece], options: PlayOptions) -> BrokenOff | None:
        self._reports.forget()
        self.mirror.sent.clear()
        play = Play(self._session, self._config, self.mirror, self._reports, pieces, options)
        self._play = play
        try:
            return await play.run()
        finally:
            self._play = None
