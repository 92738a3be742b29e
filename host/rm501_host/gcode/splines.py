"""G5, G5.1, G5.2 and G5.3: curves in the XY plane, kept with all their control data."""

from __future__ import annotations

from rm501_host.gcode.canon import NurbsFeed, Plane
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import GcodeGeometryError, GcodeModalError
from rm501_host.gcode.expressions import to_integer
from rm501_host.gcode.motion import Words, end_point, need_feed
from rm501_host.gcode.state import NurbsInProgress

Point = tuple[float, float]
MAX_CONTROL_POINTS = 10_000


def clamped_knots(points: int, order: int) -> tuple[float, ...]:
    """Uniform knots with both ends repeated `order` times: points + order of them."""
    last = points - order + 1
    return (0.0,) * order + tuple(float(i) for i in range(1, last)) + (float(last),) * order


def _check(ctx: Context, words: Words) -> None:
    need_feed(ctx.state, "make arc")
    if ctx.state.inverse_time and not ctx.peer_standalone:
        raise GcodeModalError("cannot use splines in inverse time feed mode", "Switch to G94.")
    if ctx.state.inverse_time and "f" not in words:
        raise GcodeModalError("F word missing with inverse time arc move", "In G93 every feed move needs its own F.")
    if ctx.state.plane is not Plane.XY:
        raise GcodeModalError("splines must be in the XY plane", "Select it with G17.")
    for word in "zabc":
        if word in words:
            raise GcodeModalError("splines may not have motion in Z, A, B, or C", f"Remove {word.upper()}.")


def _vector(ctx: Context, dx: float, dy: float) -> Point:
    """An offset of the program in canonical coordinates (G68 turns it)."""
    rotation = ctx.state.rotation
    if rotation is None:
        return dx, dy
    x, y = rotation.forward(rotation.centre[0] + dx, rotation.centre[1] + dy)
    return x - rotation.centre[0], y - rotation.centre[1]


def cubic(ctx: Context, words: Words) -> None:
    """G5: I J from the start and P Q from the end to the inner control points. Raises GcodeModalError."""
    _check(ctx, words)
    state = ctx.state
    if "p" not in words or "q" not in words:
        raise GcodeModalError("must specify both P and Q with G5", "They lead from the end to its control point.")
    if ("i" in words) != ("j" in words):
        raise GcodeModalError("must specify both I and J, or neither", "They lead from the start to its control point.")
    x, y = state.position[0], state.position[1]
    if "i" in words:
        dx, dy = _vector(ctx, words["i"], words["j"])
    elif state.spline_tangent is not None:
        dx, dy = state.spline_tangent
    else:
        ctx.warn("the first G5 without I and J: the curve starts with its control point at the start")
        dx, dy = 0.0, 0.0
    end = end_point(ctx, words)
    px, py = _vector(ctx, words["p"], words["q"])
    points = ((x, y), (x + dx, y + dy), (end[0] + px, end[1] + py), (end[0], end[1]))
    ctx.emit(NurbsFeed(points, (1.0,) * 4, clamped_knots(4, 4), 3, ctx.at))
    state.spline_tangent = (-px, -py)
    before = ctx.machine_stands_at()
    state.position = end
    ctx.mark_unfollowed(before)


def quadratic(ctx: Context, words: Words) -> None:
    """G5.1: I J from the start to the only inner control point. Raises GcodeModalError."""
    _check(ctx, words)
    state = ctx.state
    if "i" not in words and "j" not in words:
        raise GcodeModalError("must specify both I and J with G5.1", "They lead from the start to the control point.")
    if "i" not in words or "j" not in words:
        raise GcodeModalError("must specify both I and J with G5.1", "Add the missing word.")
    x, y = state.position[0], state.position[1]
    dx, dy = _vector(ctx, words["i"], words["j"])
    end = end_point(ctx, words)
    points = ((x, y), (x + dx, y + dy), (end[0], end[1]))
    ctx.emit(NurbsFeed(points, (1.0,) * 3, clamped_knots(3, 3), 2, ctx.at))
    before = ctx.machine_stands_at()
    state.position = end
    ctx.mark_unfollowed(before)


def nurbs_point(ctx: Context, words: Words) -> None:
    """G5.2 and the blocks after it: one control point each. Raises GcodeModalError."""
    state = ctx.state
    _check(ctx, words)
    nurbs = state.nurbs
    if nurbs is None:
        order = to_integer(words.get("l", 3.0), "L, the order")
        if order < 2:
            raise GcodeModalError("the order L of a NURBS is at least 2", "Usual are 3 and 4.")
        weight = words.get("p", 1.0)
        nurbs = state.nurbs = NurbsInProgress(order, [(state.position[0], state.position[1])], [weight])
        if "x" not in words and "y" not in words:
            if weight <= 0.0:
                _bad_weight()
            return
    if "x" not in words or "y" not in words:
        raise GcodeModalError("you must specify both X and Y coordinates for control points", "Add the missing word.")
    if words.get("p", 0.0) <= 0.0:
        _bad_weight()
    if len(nurbs.points) >= MAX_CONTROL_POINTS:
        raise GcodeGeometryError(f"more than {MAX_CONTROL_POINTS} control points", "Split the curve.")
    end = end_point(ctx, words)
    nurbs.points.append((end[0], end[1]))
    nurbs.weights.append(words["p"])


def _bad_weight() -> None:
    raise GcodeModalError("must specify positive weight P for every control point", "P 1 is neutral.")


def nurbs_end(ctx: Context) -> None:
    """G5.3: the curve through the gathered points. Raises GcodeModalError, GcodeGeometryError."""
    state = ctx.state
    nurbs = state.nurbs
    if nurbs is None:
        raise GcodeModalError("cannot use G5.3 without G5.2 first", "Begin the curve with G5.2.")
    if len(nurbs.points) < nurbs.order:
        raise GcodeGeometryError(
            f"you must specify a number of control points at least equal to the order L = {nurbs.order}",
            f"{len(nurbs.points)} were given, the start included.",
        )
    state.nurbs = None
    before = ctx.machine_stands_at()
    end = state.position.copy()
    end[0], end[1] = nurbs.points[-1]
    state.position = end
    ctx.mark_unfollowed(before)
    ctx.emit(
        NurbsFeed(
            tuple(nurbs.points),
            tuple(nurbs.weights),
            clamped_knots(len(nurbs.points), nurbs.order),
            nurbs.order - 1,
            ctx.at,
        )
    )
