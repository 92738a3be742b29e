"""Play is taken up on the way, within every limit, and known wherever motion ends.

The judge is an arm with play: segments stepped in integers move the motor side, the link follows through the gap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from rm501_host.config import Config, load_config
from rm501_host.kinematics import Arm
from rm501_host.moves import Dwell, JointMove, Move
from rm501_host.planner import Piece, Planner, plan_joint_move, plan_timed, via_spline
from rm501_host.planner.pieces import Law
from rm501_host.segmenter import NO_OFFSETS, OffsetLaw, PlannedSegment, Segmenter
from rm501_host.segmenter.fit import to_q48
from rm501_protocol.segment import ONE_STEP
from tests.host.planner.programs import PICK_START_DEG, at, pick_and_place
from tests.support.plan_checker import judge_samples, motor_matrix, play_segments
from tests.support.play import ideal_deg, links_deg, motor_side_deg, with_backlash

Array = NDArray[np.float64]

PLAIN = load_config()
ARM = Arm.from_config(PLAIN)
PLAY_DEG = (0.3, 0.15, 0.1, 0.2, 0.25)
LOOSE = with_backlash(PLAIN, PLAY_DEG)
FRAME_S = 320e-6


@dataclass(frozen=True)
class Made:
    """Pieces, their segments, and what an arm with play makes of them."""

    config: Config
    pieces: Sequence[Piece]
    segments: Sequence[PlannedSegment]

    @property
    def play_deg(self) -> Array:
        return np.array([joint.backlash_deg for joint in self.config.joints.ordered])

    def errors_deg(self, leads_deg: Sequence[float]) -> Array:
        """Link less law (frames + 1, 5)."""
        side = motor_side_deg(self.config, self.segments)
        return links_deg(side, self.play_deg.tolist(), leads_deg) - ideal_deg(self.config, self.segments, self.pieces)

    def offsets_deg(self) -> Array:
        """Offsets (frames + 1, 5) that the segments say."""
        blocks = []
        for number, item in enumerate(self.segments):
            frames = np.arange(item.start_frame + (number > 0), item.end_frame + 1, dtype=np.float64)
            blocks.append(item.offsets.at(frames)[0])
        return np.concatenate(blocks)


def positions(config: Config, joints: Sequence[float], offsets: Sequence[float]) -> list[int]:
    steps = motor_matrix(config) @ (np.array(joints) + np.array(offsets))
    return [*map(to_q48, steps.tolist()), 0]


def made(
    moves: Sequence[Move],
    config: Config = LOOSE,
    start: Sequence[float] = PICK_START_DEG,
    offsets: Sequence[float] = (0.0,) * 5,
) -> Made:
    pieces = list(Planner(ARM, config, start).plan(moves))
    law = OffsetLaw.still(offsets)
    return Made(config, pieces, list(Segmenter(config, positions(config, start, offsets), 11, law).segments(pieces)))


def there_and_back(joint: int, *ways: float) -> list[Move]:
    return [JointMove(joint, way, True, at(line + 1)) for line, way in enumerate(ways)]


def test_without_play_not_a_byte_changes() -> None:
    moves = pick_and_place(6000.0, 5.0)
    before = made(moves, PLAIN)
    again = list(Segmenter(PLAIN, positions(PLAIN, PICK_START_DEG, (0.0,) * 5), 11).segments(before.pieces))
    assert [item.segment for item in before.segments] == [item.segment for item in again]
    assert all(item.offsets is NO_OFFSETS and item.tail_frames == 0 for item in again)


@pytest.mark.parametrize("joint", range(5))
def test_a_joint_with_play_stands_where_it_should_after_each_reversal(joint: int) -> None:
    half = 0.5 * PLAY_DEG[joint]
    play = [0.0] * 5
    play[joint] = PLAY_DEG[joint]
    config = with_backlash(PLAIN, play)
    moves = [move for way in (6.0, -6.0, 3.0, -1.0, 0.5) for move in (*there_and_back(joint, way), Dwell(0.1, at(9)))]
    lead = [0.0] * 5
    lead[joint] = half
    loose = made(moves, config, offsets=lead)
    compensated = np.abs(loose.errors_deg(lead))
    ends = np.cumsum([item.segment.length_frames for item in loose.segments])
    rests = [end for end, item in zip(ends, loose.segments, strict=True) if not item.segment.motors]
    assert len(rests) == 5
    assert float(compensated[rests].max()) <= 0.001 / motor_matrix(config)[0, 0]
    # and without the compensation each rest after a reversal is off by the play
    stiff = Made(PLAIN, list(Planner(ARM, PLAIN, PICK_START_DEG).plan(moves)), [])
    segments = list(Segmenter(PLAIN, positions(PLAIN, PICK_START_DEG, (0.0,) * 5), 11).segments(stiff.pieces))
    side = motor_side_deg(PLAIN, segments)
    linked = links_deg(side, play, lead) + np.array(lead)
    off = np.abs(linked - ideal_deg(PLAIN, segments, stiff.pieces))
    assert float(off[-1, joint]) == pytest.approx(0.0, abs=0.001)
    second = np.cumsum([item.segment.length_frames for item in segments])
    stands = [end for end, item in zip(second, segments, strict=True) if not item.segment.motors]
    assert float(off[stands[1], joint]) == pytest.approx(PLAY_DEG[joint], abs=0.001)


def test_while_it_is_taken_up_the_error_is_never_more_than_the_play() -> None:
    loose = made(pick_and_place(6000.0, 5.0))
    errors = loose.errors_deg((0.0,) * 5)
    assert (np.abs(errors) <= loose.play_deg + 0.1 / 26.6).all()
    assert (np.abs(loose.offsets_deg()) <= 0.5 * loose.play_deg + 1e-12).all()


@pytest.mark.parametrize("jerk_limited", [False, True])
def test_law_and_take_up_together_keep_every_limit(jerk_limited: bool) -> None:
    config = with_backlash(PLAIN, PLAY_DEG, jerk_limited=jerk_limited)
    loose = made([*there_and_back(0, 20, -20, 5), *pick_and_place(6000.0, 5.0)[1:]], config)
    ideal, offsets = ideal_deg(config, loose.segments, loose.pieces), loose.offsets_deg()
    seconds = np.arange(len(ideal)) * FRAME_S
    judged = judge_samples(config, seconds, ideal + offsets)
    assert judged.worst <= 1.0 + 1e-6
    assert judged.worst > 0.9
    if jerk_limited:
        jerks = np.abs(np.diff(offsets[::10], n=3, axis=0)) / (10 * FRAME_S) ** 3
        share = config.planner.backlash_acceleration_share
        assert (jerks.max(axis=0) <= share * np.array([j.max_jerk_deg_s3 for j in config.joints.ordered])).all()
    assert play_segments(config, loose.segments, loose.pieces).worst <= 1.02 + 1e-9


def test_a_rest_waits_for_the_take_up_to_end() -> None:
    """0.1 deg takes 0.15 s at 18 deg/s2; crossing 0.15 deg of play with the tenth that is kept for it takes 0.55 s."""
    loose = made([*there_and_back(1, -2.0, 0.1), Dwell(0.2, at(3))])
    tail = sum(item.tail_frames for item in loose.segments) * FRAME_S
    assert 0.3 < tail < 0.55
    last = loose.segments[-2]
    assert last.offsets.offsets_deg(last.end_frame)[1] == 0.5 * PLAY_DEG[1]
    exact = np.array(last.end_q48[:5]) / ONE_STEP
    goal = np.array(loose.pieces[-1].rest_deg) + last.offsets.offsets_deg(last.end_frame)
    np.testing.assert_allclose(exact, motor_matrix(LOOSE) @ goal, atol=1e-4)
    assert loose.segments[-1].offsets.offsets_deg(last.end_frame) == last.offsets.offsets_deg(last.end_frame)


def test_a_joint_that_does_not_move_keeps_its_side() -> None:
    lead = (0.15, 0.075, -0.05, 0.1, -0.03)
    loose = made(there_and_back(0, 5.0, -5.0), offsets=lead)
    assert loose.segments[-1].offsets.offsets_deg(loose.segments[-1].end_frame) == (-0.15, *lead[1:])


WRIST_DEG = (0.3, 0.2)


def wrist_links_deg(config: Config, side: Array, wrist_deg: tuple[float, float]) -> Array:
    """Joints (n, 5) of a wrist whose motors (right, left) have play in their gear trains."""
    matrix = np.array(config.drive.wrist_matrix)
    links = side.copy()
    links[:, 3:] = links_deg(side[:, 3:] @ matrix.T, wrist_deg, (0.0, 0.0)) @ np.linalg.inv(matrix).T
    return links


@pytest.mark.parametrize("jerk_limited", [False, True])
def test_play_of_the_wrist_s_motors_is_taken_up_in_front_of_the_differential(jerk_limited: bool) -> None:
    """Pitch and roll in turn and together, so that the motors turn round one by one."""
    config = with_backlash(PLAIN, (0.0,) * 5, WRIST_DEG, jerk_limited=jerk_limited)
    points = [PICK_START_DEG]
    for pitch, roll in ((5, 5), (9, 4), (7, 0), (7, -4), (5, -4), (8, -2), (8.3, -2), (8.0, -2.6)):
        points.append((*PICK_START_DEG[:3], PICK_START_DEG[3] + pitch, PICK_START_DEG[4] + roll))
    moves: list[Move] = []
    for line, (first, last) in enumerate(pairwise(points)):
        for joint in (3, 4):
            if first[joint] != last[joint]:
                moves.append(JointMove(joint, last[joint] - first[joint], True, at(line)))
        moves.append(Dwell(0.1, at(line)))
    loose = made(moves, config)
    side = motor_side_deg(config, loose.segments)
    ideal = ideal_deg(config, loose.segments, loose.pieces)
    ends = np.cumsum([item.segment.length_frames for item in loose.segments])
    rests = [end for end, item in zip(ends, loose.segments, strict=True) if not item.segment.motors]
    off = np.abs(wrist_links_deg(config, side, WRIST_DEG) - ideal)[rests]
    assert float(off.max()) <= 0.11 / 26.6
    # the same number for both joints is not the same thing
    joints = made(moves, with_backlash(PLAIN, (0.0, 0.0, 0.0, 0.25, 0.25), jerk_limited=jerk_limited))
    side = motor_side_deg(PLAIN, joints.segments)
    ends = np.cumsum([item.segment.length_frames for item in joints.segments])
    rests = [end for end, item in zip(ends, joints.segments, strict=True) if not item.segment.motors]
    apart = wrist_links_deg(PLAIN, side, WRIST_DEG) - ideal_deg(PLAIN, joints.segments, joints.pieces)
    assert float(np.abs(apart)[rests].max()) > 0.05
    judged = judge_samples(config, np.arange(len(ideal)) * FRAME_S, ideal + loose.offsets_deg())
    assert 0.9 < judged.worst <= 1.0 + 1e-6
    assert play_segments(config, loose.segments, loose.pieces).worst <= 1.02 + 1e-9


@st.composite
def journeys(draw: st.DrawFn) -> list[tuple[float, ...]]:
    """Joint-space points near the start; most joints turn round at most of them, some within their take-up."""
    size = draw(st.sampled_from([0.02, 0.3, 4.0]))
    count = draw(st.integers(2, 5))
    return [tuple(PICK_START_DEG[joint] + draw(st.floats(-1, 1)) * size for joint in range(5)) for _ in range(count)]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(journeys(), st.sampled_from([0.02, 0.2, 1.0]), st.booleans())
def test_random_reversals_stay_legal_and_end_where_they_should(
    points: list[tuple[float, ...]], size: float, on_motors: bool
) -> None:
    config = with_backlash(
        PLAIN,
        [play * size for play in PLAY_DEG],
        (WRIST_DEG[0] * size, WRIST_DEG[1] * size) if on_motors else (0.0, 0.0),
    )
    segmenter = Segmenter(config, positions(config, PICK_START_DEG, (0.0,) * 5), 0)
    pieces: list[Piece] = []
    for first, last in pairwise([PICK_START_DEG, *points]):
        pieces += plan_joint_move(ARM, config, first, last, start_s=pieces[-1].end_s if pieces else 0.0)
    if not pieces:
        return
    loose = Made(config, pieces, list(segmenter.segments(pieces)))
    judged = judge_samples(
        config,
        np.arange(sum(item.segment.length_frames for item in loose.segments) + 1) * FRAME_S,
        ideal_deg(config, loose.segments, pieces) + loose.offsets_deg(),
    )
    assert judged.worst <= 1.0 + 1e-6
    assert play_segments(config, loose.segments, pieces).worst <= 1.02 + 1e-9
    most = 0.5 * loose.play_deg + np.array([0, 0, 0, 1, 1]) * on_motors * size * 0.25 * sum(WRIST_DEG)
    assert (np.abs(loose.offsets_deg()) <= most + 1e-12).all()
    side = motor_side_deg(config, loose.segments)
    apart = (side - ideal_deg(config, loose.segments, pieces) - loose.offsets_deg()) @ motor_matrix(config).T
    assert float(np.abs(apart).max()) <= config.planner.tolerance_steps
    rests = [
        sum(item.segment.length_frames for item in loose.segments[: k + 1])
        for k, item in enumerate(loose.segments)
        if item.segment.flags & item.segment.flags.ENDS_AT_REST
    ]
    assert float(np.abs(apart[rests]).max()) <= 1e-4


@dataclass(frozen=True)
class _Rest:
    """What is left of a law from a time on."""

    law: Law
    from_s: float

    def q_deg(self, time_s: Array) -> Array:
        return self.law.q_deg(time_s + self.from_s)

    def states(self, time_s: Array) -> tuple[Array, Array, Array]:
        return self.law.states(time_s + self.from_s)

    def lines(self, time_s: Array) -> NDArray[np.int64]:
        return self.law.lines(time_s + self.from_s)

    def kinks_s(self) -> tuple[Array, Array]:
        times, sides = self.law.kinks_s()
        later = times > self.from_s
        return times[later] - self.from_s, sides[later]


@pytest.mark.parametrize("jerk_limited", [False, True])
def test_going_on_from_any_segment_gives_the_same_offsets(jerk_limited: bool) -> None:
    """What a segment carries is all that is needed to go on behind it, in the middle of a take-up too."""
    config = with_backlash(PLAIN, [2 * play for play in PLAY_DEG], jerk_limited=jerk_limited)
    # out, back and a little out again, all on one arc of the tool: the waist turns round without a rest
    law = via_spline([0.0, 8.0, 6.0, 7.0, 0.0], [0.0, 1.5, 2.2, 2.7, 5.12])
    points = np.linspace(0.0, 5.12, 33)
    angles = np.tile(np.array(PICK_START_DEG), (33, 1))
    angles[:, 0] += law.evaluate(points, 0)
    (piece,) = plan_timed(ARM, config, PICK_START_DEG, angles, points)
    start = positions(config, PICK_START_DEG, (0.0,) * 5)
    whole = list(Segmenter(config, start, 11).segments([piece]))
    between = 0
    for before, at_border in pairwise(whole):
        left = (at_border.start_frame - 11) * FRAME_S
        assert piece.law is not None
        rest = replace(
            piece,
            start_s=left,
            duration_s=piece.duration_s - left,
            law=_Rest(piece.law, left),
            starts_at_rest=False,
        )
        again = list(Segmenter(config, at_border.start_q48, at_border.start_frame, before.offsets).segments([rest]))
        assert play_segments(config, again, [rest]).worst <= 1.02 + 1e-9
        assert again[-1].end_frame == whole[-1].end_frame
        frames = np.arange(at_border.start_frame, again[-1].end_frame + 1, dtype=np.float64)
        first, second = _offsets_at(whole, frames), _offsets_at(again, frames)
        between += abs(float(first[0, 0])) < PLAY_DEG[0]
        # a reversal that was just about to be seen is seen a sample later
        assert float(np.abs(first - second).max()) <= 0.02
        assert second[-1].tolist() == first[-1].tolist()
    assert between >= 3


def _offsets_at(planned: Sequence[PlannedSegment], frames: Array) -> Array:
    """Offsets (n, 5) that the segments say at frames (n,)."""
    result = np.zeros((len(frames), 5))
    for item in planned:
        inside = (frames >= item.start_frame) & (frames <= item.end_frame)
        result[inside] = item.offsets.at(frames[inside])[0]
    return result
