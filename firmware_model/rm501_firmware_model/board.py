"""The board as the outside sees it: bytes in, bytes out, frames run against pins.

`Board` is the reference: it makes one frame after the other with `Core`, which is written as firmware.
`fast.FastBoard` has the same interface and gives the same port words and the same bytes. What is here, outside the
tick path, is the main loop of a firmware: it hands messages to `Commands` and turns what `Core` has to report into
messages.

Time on the link is that of the frames: frame number x frame length. There is no other clock.
"""

from __future__ import annotations

from dataclasses import replace

from rm501_protocol.board_config import RM501_BOARD, BoardConfig
from rm501_protocol.board_link import BoardLink
from rm501_protocol.declaration import Message
from rm501_protocol.enums import BoardState, Capability, EndCause, HandState, HoldCause
from rm501_protocol.errors import ConfigError
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.link_events import Received, SessionOpened, StopKind, StopReceived, Undecodable
from rm501_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    FaultReport,
    Identify,
    MotionEnded,
    Status,
    TriggerReport,
)
from rm501_protocol.transport import Codec

from .commands import Commands
from .core import Core
from .core_state import Report
from .inputs import TRIGGER_SLOTS
from .layout import BoardLayout
from .pins import Pins
from .segment_queue import FRAME_MASK, QUEUE_SLOTS
from .states import Stimulus

__all__ = ["BUILD", "Board"]

BUILD = "rm501 firmware model"
CLOCK_HZ = 1_000_000


class Board:
    """One board: configuration, pins and link.

    `boot_epoch` stands for the random number that a real board draws at boot. Without `configured` the board is as
    new: it uses `config` for its pins, but refuses motion until a configuration has been committed. `codec` is the
    link's, a byte stream by default; `bytes_per_second` is the speed of the line, which the link keeps to.
    `first_frame` and `first_motion_frame` (u32) are the numbers of the first frames, 0 on real hardware: with others a
    wrap of the counters, which takes 15 days, is seconds away. Raises ConfigError for a contradictory configuration.
    """

    def __init__(
        self,
        config: BoardConfig = RM501_BOARD,
        pins: Pins | None = None,
        boot_epoch: int = 1,
        *,
        configured: bool = True,
        codec: Codec | None = None,
        bytes_per_second: int | None = 25_000,
        first_frame: int = 0,
        first_motion_frame: int = 0,
    ) -> None:
        problems = config.problems()
        if problems:
            raise ConfigError(problems)
        if pins is None:
            raise TypeError("Board needs pins: an environment that implements rm501_firmware_model.Pins")
        self._pins = pins
        self._config = config
        self._core = Core(BoardLayout(config), QUEUE_SLOTS, 1 if configured else 0)
        self._core.number_from(first_frame, first_motion_frame)
        self._commands = Commands(self._core, self._send, self._configure)
        self._link = BoardLink(boot_epoch, self._identity(), codec=codec, bytes_per_second=bytes_per_second)

    # ------------------------------------------------------------------------------------------------------------
    # public

    @property
    def frame(self) -> int:
        """Number of the real frame to be made next, from `first_frame` at boot; never wraps here."""
        return self._core.real_frame

    @property
    def frame_us(self) -> int:
        """Length of a frame in microseconds."""
        return self._core.layout.frame_us

    @property
    def state(self) -> BoardState:
        """The board's state."""
        return self._core.state

    @property
    def config(self) -> BoardConfig:
        """The configuration in force."""
        return self._config

    @property
    def link(self) -> BoardLink:
        """The board's end of the link."""
        return self._link

    @property
    def positions_q48(self) -> tuple[int, ...]:
        """Commanded positions of all motors in 2^-48 step; the hand's counts pulses."""
        core = self._core
        positions = list(core.stepgen.position)
        if core.layout.hand_motor < len(positions):
            positions[core.layout.hand_motor] = core.hand.count << 48
        return tuple(positions)

    def receive(self, data: bytes) -> None:
        """Bytes from the line; what they say takes effect in the frame that is made next."""
        self._link.receive_data(data, self._now_us())
        self._handle_events()

    def transmit(self) -> bytes:
        """Bytes for the line, as many as may be handed out now."""
        return b"".join(self.transmit_packets())

    def transmit_packets(self) -> list[bytes]:
        """As `transmit`, one item a packet, for transports that keep packets apart."""
        self._report()
        self._link.free_slots = self._core.queue.slots - self._core.queue.count
        return self._link.packets_to_send(self._now_us())

    def next_transmit_frame(self) -> int | None:
        """Frame by which `transmit` should be called again for the link's own sake; None: only for a new reason."""
        deadline_us = self._link.next_deadline_us()
        return None if deadline_us is None else -(-deadline_us // self.frame_us)

    def quiet_until(self) -> int:
        """First frame that may give the board something to say, as far as is known now; at least `frame`.

        Unless bytes arrive or the promise of the pins is withdrawn, `transmit` at this frame or earlier gives nothing
        more, and whoever paces the board need not run it before. The reference makes no such promise.
        """
        return self._core.real_frame

    def run_until(self, frame: int) -> None:
        """Make all frames up to `frame`, exclusive."""
        core = self._core
        pins = self._pins
        while core.real_frame < frame:
            number = core.real_frame
            core.frame(pins.read_inputs(number))
            pins.write_frame(number, core.words)
            if core.reports:
                self._report()

    def raise_fault(self, fault: FaultCode, source: int = 0, value: int = 0, limit: int = 0) -> None:
        """Latch a fault found below this model, as a watchdog or a memory check of real hardware would."""
        core = self._core
        core.answers(Stimulus.HARD_FAULT)
        core.hard_stop(fault, source, value, limit)

    # --------------------------------------------------------------------------------------------------------------
    # link

    def _now_us(self) -> int:
        return self._core.real_frame * self._core.layout.frame_us

    def _handle_events(self) -> None:
        core = self._core
        heard_us = self._link.last_heard_us
        if heard_us is not None and heard_us == self._now_us():
            core.heard()
        while (event := self._link.next_event()) is not None:
            if isinstance(event, StopReceived):
                if event.kind is StopKind.STOP:
                    core.stop()
                else:
                    core.kill()
            elif isinstance(event, Received):
                self._commands.obey(event.message, event.sequence or 0)
            elif isinstance(event, SessionOpened):
                core.answers(Stimulus.SESSION_OPENED)
                core.session_opened()
            elif isinstance(event, Undecodable):  # pragma: no branch  # a board's link has no other events
                self._commands.refuse(event.message_id, event.sequence, RefusalReason.MALFORMED)
            self._report()

    def _send(self, message: Message) -> bool:
        return self._link.send(message)

    def _identity(self) -> Identify:
        config = self._config
        layout = self._core.layout
        capabilities = Capability.CUBIC
        for mask, capability in (
            (layout.power_mask, Capability.MOTOR_POWER),
            (layout.heartbeat_mask, Capability.HEARTBEAT),
            (layout.estop_mask, Capability.ESTOP),
            (layout.hold_mask, Capability.HOLD_BUTTON),
            (layout.cycle_start_mask, Capability.CYCLE_START_BUTTON),
        ):
            if mask:
                capabilities |= capability
        return Identify(
            major=PROTOCOL_MAJOR,
            minor=PROTOCOL_MINOR,
            capabilities=capabilities,
            base_period_us=config.timing.base_period_us,
            frame_periods=layout.periods,
            clock_hz=CLOCK_HZ,
            queue_depth=self._core.queue.slots,
            motor_count=layout.motor_count,
            max_step_rate=layout.max_step_rate,
            config_hash=layout.config_hash if self._core.configured else 0,
            build=BUILD,
        )

    def _configure(self, config: BoardConfig) -> None:
        """Put another configuration in force: as after a boot, but for the frame count and the link."""
        old = self._core
        core = Core(BoardLayout(config), QUEUE_SLOTS, 1)
        core.stimulus = Stimulus.CONFIG_COMMIT
        core.number_from(-(-old.real_frame * old.layout.frame_us // core.layout.frame_us), 0)
        core.reports = old.reports | Report.STATUS
        self._core = core
        self._config = config
        self._commands.core = core
        self._link.identity = replace(self._identity(), boot_id=self._link.identity.boot_id)

    # -----------------------------------------------------------------------------------------------------------
    # reports

    def _report(self) -> None:
        """Turn what the core has to tell into messages; without a session it waits, but for status."""
        core = self._core
        if not core.reports:
            return
        if core.reports & Report.NEW_GENERATION:
            core.reports &= ~Report.NEW_GENERATION
            self._link.advance_generation()
        if not self._link.is_open:
            core.reports &= ~Report.STATUS
            return
        if core.reports & Report.FAULT and self._send(self._fault_report()):
            core.reports &= ~Report.FAULT
        if core.reports & Report.TRIGGER:
            self._report_triggers()
        if core.reports & Report.ENDED and self._send(
            MotionEnded(EndCause(core.ended_cause), core.motion.motion_frame, core.ended_frame, self.positions_q48)
        ):
            core.reports &= ~Report.ENDED
        if core.reports & Report.STATUS:
            core.reports &= ~Report.STATUS
            self._send(self._status())

    def _fault_report(self) -> FaultReport:
        core = self._core
        return FaultReport(
            FaultCode(core.fault),
            core.fault_source,
            core.fault_value,
            core.fault_limit,
            core.fault_frame * core.layout.frame_us & FRAME_MASK,
            core.fault_frame,
            core.fault_motion_frame,
        )

    def _report_triggers(self) -> None:
        core = self._core
        triggers = core.triggers
        for trigger in range(TRIGGER_SLOTS):
            if not core.fired >> trigger & 1:
                continue
            base = trigger * triggers.motors
            report = TriggerReport(
                trigger,
                triggers.real_frame[trigger],
                triggers.motion_frame[trigger],
                triggers.real_frame[trigger] * core.layout.frame_us & FRAME_MASK,
                tuple(triggers.positions[base : base + triggers.motors]),
            )
            if self._send(report):
                core.fired &= ~(1 << trigger)
        if core.fired == 0:
            core.reports &= ~Report.TRIGGER

    def _status(self) -> Status:
        core = self._core
        motion = core.motion
        layout = core.layout
        positions = list(core.stepgen.count)
        if layout.hand_motor < len(positions):
            positions[layout.hand_motor] = core.hand.count
        lease_frames = max(0, core.lease_end - core.real_frame)
        stats = self._link.stats
        return Status(
            real_frame=core.real_frame & FRAME_MASK,
            clock_ticks=self._now_us() & FRAME_MASK,
            motion_frame=motion.motion_frame,
            phase=motion.phase,
            rate=motion.rate,
            override=motion.target,
            state=core.state,
            hold_cause=HoldCause(core.shown_cause()),
            fault=FaultCode(core.fault),
            queue_used=core.queue.count,
            queue_free=core.queue.slots - core.queue.count,
            queue_end_frame=core.checker.end_frame,
            positions_steps=tuple(positions),
            trusted_mask=core.trusted,
            power=bool(core.power),
            hand=HandState(core.hand.state),
            inputs=core.inputs.active,
            outputs=core.digital,
            armed_triggers=core.triggers.armed_mask(),
            lease_ms=min(0xFFFF, lease_frames * layout.frame_us // 1000),
            later_faults=core.later_faults,
            bad_frames=(stats.bad_frames + stats.bad_packets) & 0xFFFF,
            refused=self._commands.refused_count,
        )
