"""What is known of the play at every frame that was sent, cut, or ended early."""

from __future__ import annotations

import pytest

from rm501_host.config import load_config
from rm501_host.kinematics import Arm
from rm501_host.motion.offsets import PlayOffsets
from rm501_host.planner import plan_joint_move
from rm501_host.segmenter import PlannedSegment, Segmenter
from rm501_host.segmenter.fit import to_q48
from tests.support.plan_checker import motor_matrix
from tests.support.play import with_backlash

CONFIG = with_backlash(load_config(), (0.4, 0.0, 0.0, 0.0, 0.0))
ARM = Arm.from_config(CONFIG)
START = (0.0, 60.0, -60.0, 60.0, 0.0)


def there_and_back(way_deg: float) -> list[PlannedSegment]:
    """Up by `way_deg` and down again, from the middle of the play, from frame 100 on."""
    there = (way_deg, *START[1:])
    positions = [*map(to_q48, (motor_matrix(CONFIG) @ START).tolist()), 0]
    pieces = (*plan_joint_move(ARM, CONFIG, START, there), *plan_joint_move(ARM, CONFIG, there, START))
    return list(Segmenter(CONFIG, positions, 100).segments(pieces))


def sent(planned: list[PlannedSegment]) -> PlayOffsets:
    offsets = PlayOffsets(CONFIG)
    for item in planned:
        offsets.add(item)
    return offsets


def test_at_every_frame_it_is_what_the_segment_says() -> None:
    planned = there_and_back(20.0)
    offsets = sent(planned)
    assert offsets.at(0) == (0.0,) * 5
    seen = set()
    for item in planned:
        for frame in (item.start_frame, (item.start_frame + item.end_frame) // 2):
            assert offsets.at(frame) == item.offsets.offsets_deg(frame)
            seen.add(round(offsets.at(frame)[0], 3))
    assert {0.0, 0.2, -0.2} <= seen
    assert offsets.deg == offsets.at(planned[-1].end_frame) == offsets.at(10**9) == (-0.2, 0.0, 0.0, 0.0, 0.0)


def test_an_early_end_keeps_what_was_there_and_forgets_what_did_not_happen() -> None:
    planned = there_and_back(20.0)
    crossing = next(item for item in planned if 0.0 < item.offsets.offsets_deg(item.start_frame + 20)[0] < 0.19)
    frame = crossing.start_frame + 20
    offsets = sent(planned)
    between = offsets.at(frame)
    offsets.end_at(frame)
    assert offsets.deg == offsets.at(planned[-1].end_frame) == between
    assert offsets.law.offsets_deg(frame + 5000) == between
    offsets.end_at(planned[-1].end_frame)
    assert offsets.deg == between


def test_what_is_cut_is_replaced() -> None:
    first, second = there_and_back(20.0), there_and_back(3.0)
    turning = next(
        item for item in second if item.offsets.offsets_deg(item.end_frame)[0] < 0.1 and item is not second[0]
    )
    cut = next(item for item in first if item.start_frame >= second[0].end_frame)
    offsets = sent(first)
    offsets.cut_at(cut.start_frame)
    assert offsets.deg == first[first.index(cut) - 1].offsets.offsets_deg(cut.start_frame)
    offsets.cut_at(100)
    assert offsets.deg == (0.0,) * 5
    for item in second:
        offsets.add(item)
    assert offsets.at(turning.end_frame) == turning.offsets.offsets_deg(turning.end_frame)
    assert offsets.at(turning.end_frame) != sent(first).at(turning.end_frame)


def test_without_play_nothing_is_kept() -> None:
    offsets = PlayOffsets(CONFIG)
    plain = load_config()
    positions = [*map(to_q48, (motor_matrix(plain) @ START).tolist()), 0]
    for item in Segmenter(plain, positions, 0).segments(plan_joint_move(ARM, plain, START, (5.0, *START[1:]))):
        offsets.add(item)
    assert offsets.deg == offsets.at(100) == (0.0,) * 5
    offsets.set((0.1, 0.0, 0.0, 0.0, 0.0))
    assert offsets.deg[0] == pytest.approx(0.1)
