"""The fast path gives the port words and the bytes of the reference, bit for bit."""

from __future__ import annotations

import random

import numpy as np
import pytest

from rm501_firmware_model import Board, FastBoard
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import BoardState, Edge, TriggerAction
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
from rm501_protocol.segment_message import Segment
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import ONE, Rig


def script(seed: int, rig: Rig) -> None:
    """One random run; everything in it depends on the seed and on what the board answers."""
    rng = random.Random(seed)
    motion = LegalMotion(rng)
    rig.send(SetStatusPeriod(rng.choice((0, 20, 100))))
    waiting: list[Segment] = list(motion.run(rng.randint(3, 40), longest=rng.choice((60, 400, 3000))))
    for _ in range(60):
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
        rig.run(rng.choice((1, 7, 64, 700, 3000)), rng.choice((64, 1000)))
        if rig.state in (BoardState.FAULT, BoardState.IDLE):
            if rig.status().inputs & 1:
                rig.pins.toggle(InputId.OVERFLOW_724)
                rig.run(5)
            rig.run(3000)
            rig.send(Reset(rig.status().fault), SetPower(True))
            waiting = []
            restarted = LegalMotion(rng, start_frames=rig.status().queue_end_frame)
            waiting = list(restarted.run(rng.randint(3, 10)))
        elif not waiting and rig.state is BoardState.READY:
            waiting = list(LegalMotion(rng, start_frames=rig.status().queue_end_frame).run(5))
        rig.send(StatusRequest())
    rig.run(50)


@pytest.mark.parametrize("seed", range(12))
def test_same_words_and_bytes_as_the_reference(seed: int) -> None:
    slow, fast = Rig(board=Board), Rig(board=FastBoard)
    script(seed, slow)
    script(seed, fast)
    assert slow.board.frame == fast.board.frame
    assert slow.sent_bytes == fast.sent_bytes
    words_slow, words_fast = slow.pins.words(), fast.pins.words()
    differing = np.flatnonzero((words_slow != words_fast).any(axis=1))
    assert len(differing) == 0, f"frames {differing[:5]} of {len(words_slow)} differ"
    assert slow.board.positions_q48 == fast.board.positions_q48
    assert len(fast.pins.blocks) > 5  # the fast path was used
