"""The fast path gives the port words and the bytes of the reference, bit for bit."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from rm501_firmware_model import Board, FastBoard
from rm501_protocol.board_config import RM501_BOARD, BoardConfig, InputId
from rm501_protocol.config_pages import MotorLimits, OutputSource
from rm501_protocol.enums import BoardState, Edge, SegmentFlag, TriggerAction
from rm501_protocol.link_events import StopKind
from rm501_protocol.messages import (
    ArmTrigger,
    Hold,
    Reset,
    Resume,
    SetOverride,
    SetPower,
    SetStatusPeriod,
    Start,
    StatusRequest,
    Truncate,
)
from rm501_protocol.segment_message import MotorTerm, Segment
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import ONE, Rig
from tests.firmware_model.torture import HOT_BOARD
from tests.firmware_model.waves import motor_waves, timing_violations


def script(seed: int, rig: Rig) -> None:
    """One random run; everything in it depends on the seed and on what the board answers."""
    rng = random.Random(seed)
    config = rig.board.config
    motion = LegalMotion(rng, config)
    rig.send(SetStatusPeriod(rng.choice((0, 20, 100))))
    waiting: list[Segment] = list(motion.run(rng.randint(3, 40), longest=rng.choice((60, 400, 3000))))
    for _ in range(40):
        while waiting and rig.status().queue_free > 0:
            rig.send(waiting.pop(0))
        kind = rng.random()
        if rig.state is BoardState.READY:
            rig.send(Start())
        if rig.state is BoardState.HELD and kind < 0.7:
            rig.send(SetOverride(ONE), Resume())
        elif kind < 0.08:
            rig.send(Hold())
        elif kind < 0.2:
            rig.send(SetOverride(rng.choice((0, 1, ONE // 3, ONE - 1, ONE, rng.randint(0, ONE)))))
        elif kind < 0.24:
            rig.send(ArmTrigger(0, InputId.SWITCH_WAIST, rng.choice(list(Edge)), rng.choice(list(TriggerAction))))
        elif kind < 0.3:
            at = rig.board.frame + rng.randint(1, 300)
            for bounce in range(rng.choice((1, 1, 2, 5))):
                rig.pins.toggle_at(at + bounce, rng.choice((InputId.SWITCH_WAIST, InputId.HOLD, InputId.CYCLE_START)))
        elif kind < 0.33:
            rig.send(Truncate(rig.status().motion_frame + rng.randint(-50, 4000) & 0xFFFFFFFF))
        elif kind < 0.35:
            rig.stop(rng.choice((StopKind.STOP, StopKind.KILL)))
        elif kind < 0.37:
            rig.pins.toggle(InputId.OVERFLOW_724)
        rig.run(rng.choice((1, 7, 64, 700, 3000)), rng.choice((13, 64, 1000)))
        if rig.state in (BoardState.FAULT, BoardState.IDLE):
            if rig.status().inputs & 1:
                rig.pins.toggle(InputId.OVERFLOW_724)
                rig.run(5)
            rig.run(3000)
            rig.send(Reset(rig.status().fault), SetPower(True))
            waiting = []
            restarted = LegalMotion(rng, config, start_frames=rig.status().queue_end_frame)
            waiting = list(restarted.run(rng.randint(3, 10)))
        elif not waiting and rig.state is BoardState.READY:
            waiting = list(LegalMotion(rng, config, start_frames=rig.status().queue_end_frame).run(5))
        rig.send(StatusRequest())
    rig.run(50)


SLOW_PULSES = replace(
    RM501_BOARD,
    timing=replace(
        RM501_BOARD.timing, step_length_frames=2, step_space_frames=2, dir_setup_frames=3, dir_hold_frames=5
    ),
    motors=replace(
        RM501_BOARD.motors,
        motors=(*(MotorLimits(780, 18_000),) * 5, MotorLimits(0, 0)),
        margin_permille=0,
        velocity_step_steps_s=40,
    ),
    hand=replace(RM501_BOARD.hand, pulse_rate_hz=600),
)
NO_EXTRAS = replace(
    RM501_BOARD,
    pins=replace(
        RM501_BOARD.pins,
        outputs=tuple(pin for pin in RM501_BOARD.pins.outputs if pin.source != OutputSource.HEARTBEAT),
    ),
)
CONFIGS = {"rm501": RM501_BOARD, "hot": HOT_BOARD, "slow": SLOW_PULSES, "bare": NO_EXTRAS}


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(
    "config", [RM501_BOARD, HOT_BOARD, SLOW_PULSES, NO_EXTRAS], ids=["rm501", "hot", "slow", "bare"]
)
def test_same_words_and_bytes_as_the_reference(seed: int, config: BoardConfig) -> None:
    if seed >= 4 and config is not RM501_BOARD:
        pytest.skip("four seeds are enough for these")
    slow, fast = Rig(config, board=Board), Rig(config, board=FastBoard)
    script(seed, slow)
    script(seed, fast)
    assert slow.board.frame == fast.board.frame
    assert slow.sent_bytes == fast.sent_bytes
    words_slow, words_fast = slow.pins.words(), fast.pins.words()
    differing = np.flatnonzero((words_slow != words_fast).any(axis=1))
    assert len(differing) == 0, f"frames {differing[:5]} of {len(words_slow)} differ"
    assert slow.board.positions_q48 == fast.board.positions_q48
    assert len(fast.pins.blocks) > 5  # the fast path was used


def test_a_gated_start_is_waited_for_in_one_stretch() -> None:
    boards = []
    for kind in (Board, FastBoard):
        rig = Rig(board=kind)
        flags = SegmentFlag.ENDS_AT_REST
        rig.send(rig.segment(300, flags=flags), Start(True, 900))
        rig.run(2000, 400)
        boards.append(rig)
    assert boards[0].sent_bytes == boards[1].sent_bytes
    assert np.array_equal(boards[0].pins.words(), boards[1].pins.words())
    assert boards[1].state is BoardState.READY


TINY = int(0.0063 * 2**32)  # from one sign to the other within the jump of speed that SLOW_PULSES allows
REVERSALS = {
    "a step falls due the other way while DIR is held": ((80, TINY), (300, -TINY)),
    "a step falls due while DIR is set up": ((79, -TINY), (1, TINY), (300, -TINY)),
    "the speed turns where a stretch begins": ((79, -TINY), (1, -TINY), (1, 0), (300, TINY), (40, -TINY), (300, TINY)),
    "to and fro about half a step": ((79, TINY), *((1 + n % 4, TINY * (-1) ** n) for n in range(20)), (200, -TINY)),
}


@pytest.mark.parametrize("pieces", REVERSALS.values(), ids=REVERSALS.keys())
@pytest.mark.parametrize("first", [*range(8), 60, 61, 64])
def test_late_steps_in_the_fast_path(pieces: tuple[tuple[int, int], ...], first: int) -> None:
    boards = []
    for kind in (Board, FastBoard):
        rig = Rig(SLOW_PULSES, board=kind)
        (length, v), *others = pieces
        segments = [rig.segment(length + first % 60 // 4, MotorTerm(2, v))]
        segments += [rig.segment(length, MotorTerm(2, v)) for length, v in others]
        rig.go(*segments, rig.segment(40, flags=SegmentFlag.ENDS_AT_REST))
        rig.run(82 + first, 100)  # where the next stretch begins
        rig.run(1500, 500)
        boards.append(rig)
    slow, fast = boards
    assert np.array_equal(slow.pins.words(), fast.pins.words())
    assert slow.sent_bytes == fast.sent_bytes
    assert slow.board.positions_q48 == fast.board.positions_q48
    wave = motor_waves(slow.pins.words(), SLOW_PULSES)[2]
    assert timing_violations(wave, SLOW_PULSES) == [] and len(wave.rises())
