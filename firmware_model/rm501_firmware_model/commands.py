"""What each message does, after the transition table has let it through: guards, refusals, effects.

This is not the tick path: messages are values that the protocol has decoded. Every handler either takes effect as a
whole or refuses and changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rm501_protocol.board_config import BoardConfig
from rm501_protocol.config_pages import ConfigCommit, ConfigPage
from rm501_protocol.declaration import Message
from rm501_protocol.enums import BoardState, Edge, EndCause, HoldCause, ResumeCause, SegmentFlag
from rm501_protocol.errors import ConfigError
from rm501_protocol.faults import FaultCode, RefusalReason
from rm501_protocol.messages import (
    NO_MOTOR,
    RATE_ONE,
    ArmTrigger,
    ConfigAccepted,
    DisarmTrigger,
    Hold,
    Lease,
    Refused,
    Reset,
    Resume,
    SetOutputs,
    SetOverride,
    SetPositions,
    SetPower,
    SetStatusPeriod,
    Start,
    StatusRequest,
    Truncate,
    Truncated,
)
from rm501_protocol.segment_message import Segment

from .core import MASTER_RESET_FRAMES, Core
from .core_state import Report
from .inputs import TRIGGER_SLOTS
from .limits import Refusal
from .segment_queue import FRAME_MASK
from .states import Stimulus, Verdict, rule

__all__ = ["Commands"]

HALF_RANGE = 1 << 31
FARTHEST_FRAMES = 1 << 30
"""How far ahead a real frame to start at may lie."""
S32_MAX = HALF_RANGE - 1


class Commands:
    """Obeys messages: `send` takes the answers, `configure` puts another configuration in force."""

    def __init__(self, core: Core, send: Callable[[Message], bool], configure: Callable[[BoardConfig], None]) -> None:
        self.core = core
        self._send = send
        self._configure = configure
        self._pages: dict[type[ConfigPage], ConfigPage] = {}
        self._refusal = Refusal()
        self.refused_count = 0

    def obey(self, message: Message, sequence: int) -> None:
        """Do what a message says, or refuse it; a StatusRequest counts as sequence 0."""
        core = self.core
        kind = ConfigPage if isinstance(message, ConfigPage) else type(message)
        entry = _HANDLERS.get(kind)
        if entry is None:
            self.refuse(message.ID, sequence, RefusalReason.NOT_SUPPORTED)
            return
        stimulus, handler = entry
        answer = rule(core.state, stimulus)
        if answer.verdict == Verdict.REFUSE:
            value = core.fault if answer.reason == RefusalReason.FAULT_LATCHED else core.state
            self.refuse(message.ID, sequence, answer.reason, NO_MOTOR, value)
            return
        if answer.verdict == Verdict.SKIP:
            return
        core.stimulus = stimulus
        self._refusal.set(0)
        handler(self, message)
        if self._refusal.reason:
            refusal = self._refusal
            self.refuse(message.ID, sequence, refusal.reason, refusal.motor, refusal.value, refusal.limit)

    def refuse(
        self, message_id: int, sequence: int, reason: int, motor: int = NO_MOTOR, value: int = 0, limit: int = 0
    ) -> None:
        """Answer that a message had no effect."""
        self.refused_count = (self.refused_count + 1) & 0xFFFF
        self._send(Refused(message_id, sequence, RefusalReason(reason), motor, _within_s32(value), _within_s32(limit)))

    def _no(self, reason: RefusalReason, value: int = 0, limit: int = 0, motor: int = NO_MOTOR) -> None:
        self._refusal.set(reason, motor, value, limit)

    # ----------------------------------------------------------------------------------------------------------- motion

    def _segment(self, message: Segment) -> None:
        core = self.core
        checker = core.checker
        if core.queue.count == 0 and core.hand.pending == 0:
            checker.hand_at_rest()
        if not checker.accepts(message, 1 if core.lease_end else 0):
            found = checker.refusal
            self._refusal.set(found.reason, found.motor, found.value, found.limit)
            return
        if message.flags & SegmentFlag.START_AT_REAL_FRAME:
            if not core.may_gate():
                self._no(RefusalReason.NOT_AT_REST, core.queue.count)
                return
            if not self._real_frame_ahead(message.real_frame):
                return
            core.motion.start_frame = message.real_frame
        core.queue.push(message)
        checker.append(message)
        if core.state == BoardState.READY:
            high_water = core.layout.high_water_frames
            queued = (checker.end_frame - core.motion.motion_frame) & FRAME_MASK
            if core.start_pending or (high_water and queued >= high_water):
                core.try_start()

    def _real_frame_ahead(self, real_frame: int) -> bool:
        now = self.core.real_frame & FRAME_MASK
        if (real_frame - now) & FRAME_MASK >= FARTHEST_FRAMES:
            self._no(RefusalReason.REAL_FRAME, real_frame, now)
            return False
        return True

    def _start(self, message: Start) -> None:
        core = self.core
        if core.queue.count == 0:
            self._no(RefusalReason.WRONG_STATE, core.state)
            return
        if message.at_real_frame:
            if not self._real_frame_ahead(message.real_frame):
                return
            core.motion.start_frame = message.real_frame
            core.motion.gated = 1
        core.start_pending = 1
        core.try_start()

    def _hold(self, message: Hold) -> None:
        self.core.hold(HoldCause.USER)

    def _resume(self, message: Resume) -> None:
        core = self.core
        low_water = 1 << HoldCause.LOW_WATER
        lost = 1 << HoldCause.LINK_LOST
        if message.cause == ResumeCause.REFILLED:
            if core.causes & ~low_water or core.causes == 0:
                self._no(RefusalReason.WRONG_CAUSE, message.cause, core.shown_cause())
                return
            core.release(low_water)
            return
        if core.causes == 1 << HoldCause.OVERRIDE:
            self._no(RefusalReason.WRONG_CAUSE, message.cause, HoldCause.OVERRIDE)
            return
        core.link_silent = 0 if core.causes & lost else core.link_silent
        core.release_by_user()

    def _set_override(self, message: SetOverride) -> None:
        core = self.core
        if message.rate > RATE_ONE:
            self._no(RefusalReason.OVERRIDE_RANGE, message.rate, RATE_ONE)
            return
        core.motion.target = message.rate
        core.reports |= Report.STATUS
        if message.rate:
            if core.causes & 1 << HoldCause.OVERRIDE:
                core.release(1 << HoldCause.OVERRIDE)
        elif core.state in (BoardState.RUNNING, BoardState.HOLDING, BoardState.HELD):
            core.hold(HoldCause.OVERRIDE)

    def _truncate(self, message: Truncate) -> None:
        core = self.core
        if not core.truncate_at(message.frame):
            self._no(RefusalReason.TOO_NEAR, message.frame, core.earliest_end())
            return
        self._send(Truncated(core.checker.end_frame))

    def _lease(self, message: Lease) -> None:
        core = self.core
        core.wake = 0
        if message.duration_ms:
            core.lease_end = core.real_frame + core.layout.frames_of_ms(message.duration_ms)
        elif core.lease_end:
            core.lease_end = 0
            core.lease_over()

    # ------------------------------------------------------------------------------------------------- position, inputs

    def _set_positions(self, message: SetPositions) -> None:
        core = self.core
        layout = core.layout
        if core.queue.count:
            self._no(RefusalReason.NOT_AT_REST, core.queue.count)
            return
        if core.power == 0 and layout.power_mask and not layout.trust_without_power:
            self._no(RefusalReason.POWER_OFF)
            return
        if message.motor_mask >> layout.motor_count or len(message.positions_steps) < layout.motor_count:
            self._no(RefusalReason.UNKNOWN_MOTOR, message.motor_mask, layout.motor_count)
            return
        core.place(message.motor_mask, message.positions_steps)

    def _arm_trigger(self, message: ArmTrigger) -> None:
        core = self.core
        if message.trigger >= TRIGGER_SLOTS:
            self._no(RefusalReason.UNKNOWN_TRIGGER, message.trigger, TRIGGER_SLOTS)
            return
        if message.input_id >= core.layout.input_count:
            self._no(RefusalReason.UNKNOWN_INPUT, message.input_id, core.layout.input_count)
            return
        core.triggers.arm(message.trigger, message.input_id, message.edge, message.action)
        active = core.inputs.active >> message.input_id & 1
        if message.level and active == (message.edge == Edge.RISING):
            core.fire(message.trigger)

    def _disarm_trigger(self, message: DisarmTrigger) -> None:
        if message.trigger >= TRIGGER_SLOTS:
            self._no(RefusalReason.UNKNOWN_TRIGGER, message.trigger, TRIGGER_SLOTS)
            return
        self.core.triggers.disarm(message.trigger)

    # ---------------------------------------------------------------------------------------------------- power,
    # outputs

    def _set_power(self, message: SetPower) -> None:
        core = self.core
        if not message.on:
            if core.power:
                core.switch_off(EndCause.POWER_OFF)
            return
        if core.power:
            return
        if core.stop_latched:
            self._no(RefusalReason.WRONG_STATE, core.state)
            return
        active = core.active_fault()
        if active:
            self._no(RefusalReason.STILL_ACTIVE, active)
            return
        core.power_on()

    def _set_outputs(self, message: SetOutputs) -> None:
        missing = message.mask & ~self.core.fitted_outputs()
        if missing:
            self._no(RefusalReason.OUTPUT_NOT_FITTED, missing)
            return
        self.core.set_outputs(message.mask, message.levels)

    def _reset(self, message: Reset) -> None:
        core = self.core
        if message.fault != core.fault:
            self._no(RefusalReason.WRONG_FAULT, message.fault, core.fault)
            return
        active = core.active_fault()
        if active and (active != FaultCode.OVERFLOW or not message.master_reset) and core.fault:
            self._no(RefusalReason.STILL_ACTIVE, active)
            return
        core.reset(MASTER_RESET_FRAMES if message.master_reset else 0)

    # -----------------------------------------------------------------------------------------------------
    # configuration

    def _page(self, message: ConfigPage) -> None:
        self._pages[type(message)] = message

    def _commit(self, message: ConfigCommit) -> None:
        core = self.core
        try:
            config = BoardConfig.from_pages(self._pages.values())
        except ConfigError:
            self._no(RefusalReason.CONFIG_INVALID, len(self._pages))
            return
        if config.hash != message.config_hash:
            self._no(RefusalReason.CONFIG_HASH, _signed(config.hash), _signed(message.config_hash))
            return
        if config.problems():
            self._no(RefusalReason.CONFIG_INVALID)
            return
        self._pages.clear()
        if config.hash != core.layout.config_hash or not core.configured:
            self._configure(config)
        self._send(ConfigAccepted(config.hash))

    # ------------------------------------------------------------------------------------------------------------
    # status

    def _set_status_period(self, message: SetStatusPeriod) -> None:
        core = self.core
        core.status_frames = core.layout.frames_of_ms(message.period_ms)
        core.status_due = core.real_frame + core.status_frames
        core.wake = 0

    def _status_request(self, message: StatusRequest) -> None:
        self.core.reports |= Report.STATUS


def _within_s32(value: int) -> int:
    """A u32 of the protocol (frames) as the s32 of the same bits; larger values saturate."""
    if HALF_RANGE <= value <= FRAME_MASK:
        return value - (FRAME_MASK + 1)
    return max(-HALF_RANGE, min(S32_MAX, value))


def _signed(word: int) -> int:
    """The s32 with the bits of a u32."""
    return word - (FRAME_MASK + 1) if word >= HALF_RANGE else word


_HANDLERS: dict[type, tuple[Stimulus, Callable[[Commands, Any], None]]] = {
    Segment: (Stimulus.SEGMENT, Commands._segment),
    Hold: (Stimulus.HOLD, Commands._hold),
    Resume: (Stimulus.RESUME, Commands._resume),
    SetOverride: (Stimulus.SET_OVERRIDE, Commands._set_override),
    Truncate: (Stimulus.TRUNCATE, Commands._truncate),
    Reset: (Stimulus.RESET, Commands._reset),
    SetPositions: (Stimulus.SET_POSITIONS, Commands._set_positions),
    ArmTrigger: (Stimulus.ARM_TRIGGER, Commands._arm_trigger),
    DisarmTrigger: (Stimulus.DISARM_TRIGGER, Commands._disarm_trigger),
    SetPower: (Stimulus.SET_POWER, Commands._set_power),
    SetOutputs: (Stimulus.SET_OUTPUTS, Commands._set_outputs),
    Lease: (Stimulus.LEASE, Commands._lease),
    Start: (Stimulus.START, Commands._start),
    SetStatusPeriod: (Stimulus.SET_STATUS_PERIOD, Commands._set_status_period),
    ConfigPage: (Stimulus.CONFIG_PAGE, Commands._page),
    ConfigCommit: (Stimulus.CONFIG_COMMIT, Commands._commit),
    StatusRequest: (Stimulus.STATUS_REQUEST, Commands._status_request),
}
