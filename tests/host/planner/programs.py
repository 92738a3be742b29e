"""Programs as moves, for the planner's tests."""

from __future__ import annotations

from collections.abc import Sequence

from rm501_host.moves import (
    ArcMove,
    Dwell,
    Feed,
    HandMove,
    LinearMove,
    Move,
    PathMode,
    PathModeChange,
    Source,
    Target,
)

PICK_START_DEG = (0.0, 80.0, -80.0, 10.0, 0.0)
POLYLINE_START_DEG = (-19.6538240581, 22.0014059785, -73.5181187478, 51.5167127692, 0.0)
POLYLINE_MM = ((340, -100), (340, -30), (310, -30), (310, 30), (340, 30), (340, 100), (280, 100))


def at(line: int) -> Source:
    return Source("test.ngc", line)


def target(x: float, y: float, z: float, a: float = 0.0, b: float = 0.0) -> Target:
    return (float(x), float(y), float(z), float(a), float(b), 0.0)


def mode(blend_mm: float | None, line: int = 1, *, merge_mm: float | None = None) -> PathModeChange:
    """G64 P, or G61.1 for None."""
    if blend_mm is None:
        return PathModeChange(PathMode.EXACT_STOP, None, None, at(line))
    return PathModeChange(PathMode.BLEND, blend_mm, merge_mm, at(line))


def lines(points: Sequence[Sequence[float]], feed_mm_min: float, first_line: int = 2) -> list[Move]:
    return [LinearMove(target(*point), Feed(feed_mm_min), at(first_line + i)) for i, point in enumerate(points)]


def quarter(x: float, y: float, z: float, angle_deg: float, feed: float, line: int) -> ArcMove:
    """An arc about the waist axis."""
    return ArcMove(target(x, y, z), (0.0, 0.0, z), (0.0, 0.0, 1.0), angle_deg, Feed(feed), at(line))


def pick_and_place(feed: float, blend_mm: float | None) -> list[Move]:
    """The thesis's program in a z-up frame (anchors.md)."""
    return [
        mode(blend_mm),
        *lines([(210, 0, 320)], feed, 3),
        quarter(0, 210, 320, 90.0, feed, 4),
        *lines([(0, 340, 200), (0, 340, 140)], feed, 5),
        Dwell(1.5, at(7)),
        HandMove(False, at(8)),
        *lines([(0, 340, 200), (0, 210, 320)], feed, 9),
        quarter(210, 0, 320, -90.0, feed, 11),
        *lines([(290, 0, 200), (290, 0, 140)], feed, 12),
        Dwell(1.5, at(14)),
        HandMove(True, at(15)),
        *lines([(290, 0, 200)], feed, 16),
    ]


def polyline(blend_mm: float | None) -> list[Move]:
    return [mode(blend_mm), *lines([(x, y, 100) for x, y in POLYLINE_MM], 30000.0)]
