"""The peer flattens splines; the points it makes must lie on the curves that our control data describe."""

from __future__ import annotations

import json

import numpy as np
import pytest

from rm501_host.gcode import Settings, interpret
from rm501_host.gcode import canon as c

from .listings import SHARED

NAMES = ["g5-cubic", "g5.1-quadratic", "g5.2-nurbs", "nurbs-weights"]


def _curve(call: c.NurbsFeed, samples: int) -> np.ndarray:
    """Points of a NURBS by de Boor's recursion in homogeneous coordinates, written for this test."""
    degree, knots = call.degree, call.knots
    weighted = [(w * x, w * y, w) for (x, y), w in zip(call.control_points, call.weights, strict=True)]
    out = []
    for u in np.linspace(knots[degree], knots[-degree - 1], samples):
        span = degree
        while span < len(weighted) - 1 and u >= knots[span + 1]:
            span += 1
        d = [np.array(weighted[span - degree + j]) for j in range(degree + 1)]
        for level in range(1, degree + 1):
            for j in range(degree, level - 1, -1):
                left = knots[span - degree + j]
                right = knots[span + 1 + j - level]
                t = (u - left) / (right - left)
                d[j] = (1 - t) * d[j - 1] + t * d[j]
        out.append(d[degree][:2] / d[degree][2])
    return np.array(out)


@pytest.mark.skipif(not (SHARED / "programs").is_dir(), reason="the shared programs are not here")
@pytest.mark.parametrize("name", NAMES)
def test_the_peers_points_lie_on_our_curve(name: str) -> None:
    folder = SHARED / "programs" / name
    text = (folder / f"{name}.ngc").read_text(encoding="utf-8")
    calls = [call for call in interpret(text, Settings.as_peer()) if isinstance(call, c.NurbsFeed)]
    curve = np.concatenate([_curve(call, 4001) for call in calls])
    last = max(call.at.line for call in calls)
    first = min(call.at.line for call in calls)
    points = [
        entry["args"][:2]
        for entry in map(json.loads, (folder / "expected.full.jsonl").read_text(encoding="utf-8").splitlines())
        if entry.get("op") == "feed" and first <= entry["line"] <= last
    ]
    assert len(points) > 10
    size = float(np.ptp(curve, axis=0).max())
    worst = max(float(np.min(np.linalg.norm(curve - np.array(point), axis=1))) for point in points)
    assert worst < 5e-4 * size
    assert points[-1] == pytest.approx(list(curve[-1]), abs=1e-9)
