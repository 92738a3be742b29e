"""Limit switches: edges, hysteresis, bounce, needles, and the promise that nothing changes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rm501_sim_board.randomness import stream
from rm501_sim_board.switches import Switch, SwitchParameters

FPS = 3125.0


def _switch(seed: int = 0, **parameters: object) -> Switch:
    values: dict[str, object] = {"angle_deg": -10.0, "active_below": True, **parameters}
    return Switch(SwitchParameters(**values), stream(seed, "switch"), FPS)  # type: ignore[arg-type]


def test_the_release_edge_is_the_angle_and_hysteresis_lies_behind_it() -> None:
    switch = _switch(hysteresis_deg=0.5)
    down = np.arange(-9.0, -11.5, -0.01)
    levels = [switch.level(f, a) for f, a in enumerate(down)]
    assert down[levels.index(True)] == pytest.approx(-10.5, abs=0.011)
    up = down[::-1]
    levels = [switch.level(10_000 + f, a) for f, a in enumerate(up)]
    assert up[levels.index(False)] == pytest.approx(-10.0, abs=0.011)


def test_an_upper_switch_is_the_mirror_image() -> None:
    switch = _switch(active_below=False, hysteresis_deg=0.5)
    assert not switch.level(0, -11.0)
    assert not switch.level(1, -9.6)
    assert switch.level(2, -9.4)
    assert switch.level(3, -9.9)
    assert not switch.level(4, -10.1)


def test_bounce_ends_in_the_new_level_and_stays_there() -> None:
    for seed in range(30):
        switch = _switch(seed, hysteresis_deg=0.2, bounce_frames=40)
        assert not switch.level(0, -9.0)
        levels = [switch.level(1 + f, -10.5) for f in range(100)]
        assert levels[0]
        assert all(levels[45:])
        assert not all(levels[:45])


def test_repeatability_scatters_the_release_edge_as_asked() -> None:
    edges = []
    switch = _switch(3, hysteresis_deg=0.4, repeatability_deg=0.03)
    frame = 0
    for _ in range(300):
        frame += 1
        assert switch.level(frame, -11.0)
        angle = -11.0
        while switch.level(frame := frame + 1, angle):
            angle += 0.002
        edges.append(angle)
        switch.level(frame := frame + 1, -9.0)
    assert np.std(edges) == pytest.approx(0.03, rel=0.15)
    assert np.mean(edges) == pytest.approx(-10.0, abs=0.01)


@given(st.integers(0, 1000), st.lists(st.floats(-1.0, 1.0), min_size=20, max_size=60))
@settings(max_examples=100, deadline=None)
def test_the_promise_of_steadiness_is_kept(seed, moves) -> None:
    """Reading every frame and reading only when a promise has ended give the same contact."""
    bound = 0.05
    parameters = {"hysteresis_deg": 0.3, "repeatability_deg": 0.02, "bounce_frames": 9, "glitches_per_second": 60.0}
    path = [-10.2]
    for move in moves:
        for _ in range(7):
            path.append(path[-1] + bound * move)
    every, lazy = _switch(seed, **parameters), _switch(seed, **parameters)
    promised_until, promised = 0, False
    for frame, angle in enumerate(path):
        level = every.level(frame, angle)
        if frame >= promised_until:
            promised = lazy.level(frame, angle)
            promised_until = frame + lazy.steady_frames(frame, angle, lambda d: int(d / bound - 1e-6))
        assert level == promised, frame
