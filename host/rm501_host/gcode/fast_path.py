"""Plain G0 to G3 blocks by one regular expression, without a parsed block in between.

Whatever it does not read for certain - other words, another order, incremental distances, arcs other than XY arcs
with I and J, anything that would be an error - it leaves to the long way, untouched. So the long way alone decides what
is wrong and says so; a property test holds the two together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

from rm501_host.gcode.canon import ArcFeed, CanonCall, Plane, SetFeedRate, StraightFeed, StraightTraverse
from rm501_host.gcode.context import Context
from rm501_host.gcode.errors import Location
from rm501_host.gcode.motion import RADIUS_TOLERANCE, SPIRAL_RELATIVE_TOLERANCE, SPIRAL_TOLERANCE
from rm501_host.gcode.parser import MAX_LINE_CHARACTERS
from rm501_host.gcode.state import State

_NUM = r"([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))"
_FAST = re.compile(
    rf"[ \t]*(?:[nN]([0-9]{{1,9}})[ \t]*(?=[^0-9. \t]))?(?:[gG]0?([0-3])(?![0-9.])[ \t]*)?(?:[fF][ \t]*{_NUM}[ \t]*)?"
    + "".join(rf"(?:[{a}{a.upper()}][ \t]*{_NUM}[ \t]*)?" for a in "xyzabcij")
    + rf"(?:[fF][ \t]*{_NUM}[ \t]*)?\Z"
)


class FastPath:
    """Bound to one interpreter's state and output."""

    def __init__(self, state: State, out: list[CanonCall], ctx: Context) -> None:
        self._state = state
        self._out = out
        self._ctx = ctx
        self._match: Callable[[str], re.Match[str] | None] = _FAST.match

    def run(self, text: str, line: int, name: str) -> bool:
        """Read and execute a block; False leaves it, and the state, untouched."""
        match = self._match(text)
        if match is None:
            return False
        n, g, feed_first, x, y, z, a, b, c, i, j, feed = match.groups()
        state = self._state
        if g is None:
            motion = state.motion
            if motion > 30 or motion < 0:
                return False
        else:
            motion = 10 * int(g)
        if (
            (x is None and y is None and z is None and a is None and b is None and c is None)
            or not state.absolute
            or state.inverse_time
            or state.rotation is not None
            or state.tool_unplaced
            or len(text) > MAX_LINE_CHARACTERS
        ):
            return False
        if feed is None:
            feed = feed_first
        elif feed_first is not None:
            return False
        rate = state.feed if feed is None else float(feed)
        if rate <= 0.0 and (motion != 0 or feed is not None):
            return False
        position = state.position
        target = (
            position[0] if x is None else float(x),
            position[1] if y is None else float(y),
            position[2] if z is None else float(z),
            position[3] if a is None else float(a),
            position[4] if b is None else float(b),
            position[5] if c is None else float(c),
        )
        at = Location(name, line, text, None if n is None else int(n))
        call: CanonCall
        if motion <= 10:
            if i is not None or j is not None:
                return False
            call = StraightTraverse(target, at) if motion == 0 else StraightFeed(target, at)
        else:
            if (i is None and j is None) or state.arc_absolute or state.plane is not Plane.XY:
                return False
            cx = position[0] + (0.0 if i is None else float(i))
            cy = position[1] + (0.0 if j is None else float(j))
            start_radius = math.hypot(cx - position[0], cy - position[1])
            end_radius = math.hypot(cx - target[0], cy - target[1])
            least = RADIUS_TOLERANCE[state.units]
            difference = abs(start_radius - end_radius)
            if start_radius < least or end_radius < least:
                return False
            if difference > SPIRAL_TOLERANCE[state.units] or difference > SPIRAL_RELATIVE_TOLERANCE * start_radius:
                return False
            turns = -1 if motion == 20 else 1
            call = ArcFeed((target[0], target[1]), (cx, cy), turns, target[2], target[3:], at)
        if feed is not None:
            state.feed = rate
            self._out.append(SetFeedRate(rate, at))
        self._out.append(call)
        position[:] = target
        state.motion = motion
        state.nurbs = None
        self._ctx.at = at
        return True
