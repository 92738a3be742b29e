"""What the planner leaves free is what all take-ups together can use, on every row, whatever has play."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_host.config import load_config
from rm501_host.planner import Limits
from tests.support.play import with_backlash

PLAIN = load_config()
WHOLE = Limits.from_config(PLAIN)
PLAYS = st.sampled_from([0.0, 0.0, 0.01, 0.3, 2.5])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.tuples(*[PLAYS] * 5), st.tuples(PLAYS, PLAYS), st.sampled_from([0.05, 0.1, 0.5]), st.booleans())
def test_law_and_all_take_ups_at_once_stay_within_every_row(
    joints: tuple[float, ...], wrist: tuple[float, float], share: float, jerk_limited: bool
) -> None:
    config = with_backlash(PLAIN, joints, wrist, backlash_acceleration_share=share, jerk_limited=jerk_limited)
    limits = Limits.from_config(config)
    # the worst of a row: every place of play at its limit in the row's own direction
    weights = np.abs(WHOLE.rows @ limits.play_columns)
    acceleration = limits.take_up_acceleration_deg_s2
    used, fast = weights @ acceleration, weights @ np.sqrt(acceleration * limits.backlash_deg)
    np.testing.assert_allclose(limits.acceleration + used, WHOLE.acceleration, rtol=1e-12)
    np.testing.assert_allclose(limits.velocity + fast, WHOLE.velocity, rtol=1e-12)
    assert (used <= share * WHOLE.acceleration * (1.0 + 1e-12)).all()
    assert (fast <= share * WHOLE.velocity * (1.0 + 1e-12)).all()
    assert ((acceleration > 0.0) == (limits.backlash_deg > 0.0)).all()
    windows = limits.take_up_window_s
    if not jerk_limited:
        assert not windows.any()
        return
    has_play = limits.backlash_deg > 0.0
    assert (windows[has_play] > 0.0).all()
    jerks = np.zeros(7)
    jerks[has_play] = 2.0 * acceleration[has_play] / windows[has_play]
    together = np.abs(limits.play_columns) @ jerks
    assert (together <= share * WHOLE.jerk_deg_s3 * (1.0 + 1e-12)).all()
    np.testing.assert_allclose(limits.jerk_deg_s3 + together, WHOLE.jerk_deg_s3, rtol=1e-12)


def test_joints_without_play_lose_nothing() -> None:
    limits = Limits.from_config(with_backlash(PLAIN, (0.3, 0.0, 0.0, 0.0, 0.0)))
    assert limits.acceleration[1:].tolist() == WHOLE.acceleration[1:].tolist()
    assert limits.velocity[1:].tolist() == WHOLE.velocity[1:].tolist()
    assert limits.acceleration[0] == pytest.approx(0.9 * WHOLE.acceleration[0])


def test_the_flank_of_a_pitch_move_is_that_of_both_wrist_motors() -> None:
    limits = Limits.from_config(with_backlash(PLAIN, (0.0, 0.0, 0.0, 0.2, 0.4), (0.3, 0.1)))
    leads = limits.on_the_flank((0.05,) * 7, 3, -1.0)
    # right = roll - pitch goes up, left = roll + pitch goes down; roll itself has not moved
    assert leads == pytest.approx((0.05, 0.05, 0.05, -0.1, 0.05, 0.15, -0.05))
