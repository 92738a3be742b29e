"""Inverse kinematics in closed form: all branches, flags, and by how much a pose fails.

Theory of operation. Pitch and roll are given literally, so the tool offset seen in the arm's plane is known before
any joint is: with (tx, ty, tz) the tool centre point in frame 5,

    g = tx c5 - ty s5,  v = -(tx s5 + ty c5),  u = g c234 + tz s234,  w = g s234 - tz c234.

The sideways offset v fixes the waist: rho^2 = x^2 + y^2 = r^2 + v^2, so r = +-sqrt(rho^2 - v^2) (front, back) and
q1 = atan2(y, x) - atan2(v, r). What is left is a planar two-link arm to the wrist centre
(dx, dz) = (r - u, z - d1 - w):

    c3 = (dx^2 + dz^2 - a2^2 - a3^2) / (2 a2 a3),   s3 = -+sqrt(1 - c3^2)   (elbow up, down)
    q2 = atan2(dz, dx) - atan2(a3 s3, a2 + a3 c3),  q4 = pitch - q2 - q3

Source: thesis 2.2 with its corrections (dx without division by c1; a2 + a3 c3 in q2; branch flags instead of the
shoulder flag of appendix C), extended by the tool offset. 1 - c3^2 is taken as a product of distances to the
boundary of the workspace, so that a stretched arm loses no digits.

The waist is undetermined where rho = 0 and v = 0 (every q1 reaches the tip's place): it stays where the seed has it.
So does the shoulder where dx = dz = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, degrees, hypot, inf, radians, sin, sqrt

from rm501_host.config import JOINT_NAMES
from rm501_host.kinematics.errors import KinematicsError
from rm501_host.kinematics.geometry import LIMIT_TOLERANCE_DEG, ArmGeometry
from rm501_host.kinematics.results import (
    Branch,
    IkResult,
    IkSolution,
    IkStatus,
    Joints,
    Shortfall,
    ShortfallKind,
)

REACH_TOLERANCE_MM = 1e-9
"""A wrist centre this far outside the workspace is rounding, and is drawn onto its boundary."""

AXIS_TOLERANCE_MM = 1e-9
"""Within this of an axis the direction to it is rounding, and the seed decides."""

SINGULAR_RADIUS_MM = 1e-6
"""|r| below which a solution is called singular: a tip speed of 1 mm/s would need 1e6 rad/s of the waist."""

SINGULAR_SINE = 1e-6
"""|sin q3| below which a solution is called singular."""

_TURN_DEG = 360.0
_FRONT_UP, _FRONT_DOWN, _BACK_UP, _BACK_DOWN = Branch


class InverseSolver:
    """The closed form for one geometry, with everything that does not depend on the pose worked out once."""

    __slots__ = (
        "_a2",
        "_a3",
        "_d1",
        "_geometry",
        "_high",
        "_home",
        "_inner",
        "_low",
        "_outer",
        "_sum_squares",
        "_tcp",
        "_two_a2_a3",
        "_weights",
    )

    def __init__(self, geometry: ArmGeometry) -> None:
        self._geometry = geometry
        self._d1, self._a2, self._a3 = geometry.d1_mm, geometry.a2_mm, geometry.a3_mm
        self._tcp = geometry.tcp_mm
        self._outer = self._a2 + self._a3
        self._inner = abs(self._a2 - self._a3)
        self._two_a2_a3 = 2.0 * self._a2 * self._a3
        self._sum_squares = self._a2 * self._a2 + self._a3 * self._a3
        self._low = tuple(angle - LIMIT_TOLERANCE_DEG for angle in geometry.min_deg)
        self._high = tuple(angle + LIMIT_TOLERANCE_DEG for angle in geometry.max_deg)
        self._home = geometry.home_deg
        self._weights = tuple(weight * weight for weight in geometry.weights)

    def solve(
        self, x: float, y: float, z: float, pitch_deg: float, roll_deg: float, seed_deg: Joints | None
    ) -> IkResult:
        """All solutions for a tip at (x, y, z) mm, base frame; see `Arm.ik`."""
        total = x + y + z + pitch_deg + roll_deg
        if total - total != 0.0:
            raise KinematicsError(
                f"a pose must be finite numbers, not xyz {(x, y, z)} mm, pitch {pitch_deg}, roll {roll_deg} deg"
            )
        seed = self._home if seed_deg is None else seed_deg
        a2, a3 = self._a2, self._a3
        tx, ty, tz = self._tcp
        pitch = radians(pitch_deg)
        c234, s234 = cos(pitch), sin(pitch)
        rho = hypot(x, y)
        if tx or ty:
            roll = radians(roll_deg)
            c5, s5 = cos(roll), sin(roll)
            g = tx * c5 - ty * s5
            v = -(tx * s5 + ty * c5)
            u = g * c234 + tz * s234
            dz = z - self._d1 - g * s234 + tz * c234
            square = (rho - abs(v)) * (rho + abs(v))
            if square < 0.0:
                if rho < abs(v) - REACH_TOLERANCE_MM:
                    return _inside_offset(abs(v) - rho)
                square = 0.0
            radius = sqrt(square)
        else:
            v = 0.0
            u = tz * s234
            dz = z - self._d1 + tz * c234
            radius = rho
        low1, low2, low3, low4, low5 = self._low
        high1, high2, high3, high4, high5 = self._high
        seed1, seed2, seed3, seed4, seed5 = seed
        weight1, weight2, weight3, weight4, weight5 = self._weights
        roll_fits = low5 <= roll_deg <= high5
        roll_part = weight5 * (roll_deg - seed5) ** 2
        found: list[tuple[bool, float, IkSolution]] = []
        too_far = too_near = inf
        on_waist_axis = radius <= AXIS_TOLERANCE_MM
        no_waist = rho <= AXIS_TOLERANCE_MM and on_waist_axis
        on_shoulder_axis = False
        singular_elbow = inf
        for front in (True, False):
            if front:
                r = radius
            elif on_waist_axis:
                break  # front and back are one
            else:
                r = -radius
            dx = r - u
            distance = hypot(dx, dz)
            beyond = distance - self._outer
            if beyond > 0.0:
                if beyond > REACH_TOLERANCE_MM:
                    too_far = min(too_far, beyond)
                    continue
                c3, s3 = 1.0, 0.0
            elif (within := self._inner - distance) > 0.0:
                if within > REACH_TOLERANCE_MM:
                    too_near = min(too_near, within)
                    continue
                c3, s3 = -1.0, 0.0
            else:
                # (2 a2 a3 s3)^2 = (outer^2 - d^2)(d^2 - inner^2)
                c3 = (distance * distance - self._sum_squares) / self._two_a2_a3
                s3 = sqrt(beyond * within * (self._outer + distance) * (distance + self._inner)) / self._two_a2_a3
            if no_waist:
                q1 = seed1
            else:
                q1 = degrees(atan2(y, x) - atan2(v, r))
                if not low1 <= q1 <= high1:
                    q1 = _turned(q1, low1, high1, seed1)
            to_wrist = atan2(dz, dx)
            inner_angle = atan2(a3 * s3, a2 + a3 * c3)
            bend = degrees(atan2(s3, c3))
            singular_elbow = min(singular_elbow, s3)
            for up in (True, False):
                if up:
                    q3 = 0.0 - bend  # no -0.0
                    q2 = degrees(to_wrist + inner_angle)
                elif s3 == 0.0:
                    break  # stretched or folded: up and down are one
                else:
                    q3 = bend
                    q2 = degrees(to_wrist - inner_angle)
                if distance <= AXIS_TOLERANCE_MM:
                    q2 = seed2
                    on_shoulder_axis = True
                if not low2 <= q2 <= high2:
                    q2 = _turned(q2, low2, high2, seed2)
                if not low3 <= q3 <= high3:
                    q3 = _turned(q3, low3, high3, seed3)
                q4 = pitch_deg - q2 - q3
                if not low4 <= q4 <= high4:
                    q4 = _turned(q4, low4, high4, seed4)
                fits = (
                    roll_fits
                    and low1 <= q1 <= high1
                    and low2 <= q2 <= high2
                    and low3 <= q3 <= high3
                    and low4 <= q4 <= high4
                )
                far = (
                    weight1 * (q1 - seed1) ** 2
                    + weight2 * (q2 - seed2) ** 2
                    + weight3 * (q3 - seed3) ** 2
                    + weight4 * (q4 - seed4) ** 2
                    + roll_part
                )
                branch = (_FRONT_UP if up else _FRONT_DOWN) if front else (_BACK_UP if up else _BACK_DOWN)
                found.append((not fits, far, IkSolution((q1, q2, q3, q4, roll_deg), branch, fits)))
        if not found:
            return _unreachable(too_far, too_near)
        if len(found) > 1:
            found.sort(key=_order)
        solutions = tuple([entry[2] for entry in found])
        best = solutions[0]
        if not best.in_limits:
            return out_of_limits(self._geometry, solutions)
        if radius < SINGULAR_RADIUS_MM or on_shoulder_axis or singular_elbow < SINGULAR_SINE:
            return _singular(best, solutions, radius, no_waist, on_shoulder_axis)
        return IkResult(IkStatus.OK, best, solutions)


def out_of_limits(geometry: ArmGeometry, solutions: tuple[IkSolution, ...]) -> IkResult:
    """The refusal of solutions that are all outside the limits: names the joints (deg) of the one that fails least."""
    per_solution = [limit_shortfalls(geometry, solution.q_deg) for solution in solutions]
    least = min(per_solution, key=lambda excesses: max(excess.amount for excess in excesses))
    reason = "; ".join(excess.text for excess in least)
    return IkResult(IkStatus.OUT_OF_LIMITS, None, solutions, reason, least)


def limit_shortfalls(geometry: ArmGeometry, q_deg: Joints) -> tuple[Shortfall, ...]:
    """Every joint of q (5,) deg that is outside its range, with the amount in deg."""
    found: list[Shortfall] = []
    for joint, angle in enumerate(q_deg):
        low, high = geometry.min_deg[joint], geometry.max_deg[joint]
        if low - LIMIT_TOLERANCE_DEG <= angle <= high + LIMIT_TOLERANCE_DEG:
            continue
        if angle < low:
            amount, side = low - angle, f"below its minimum {low:g}"
        else:
            amount, side = angle - high, f"above its maximum {high:g}"
        text = f"{JOINT_NAMES[joint]} would be at {angle:.4f} deg, {amount:.4g} deg {side}"
        found.append(Shortfall(ShortfallKind.JOINT_LIMIT, amount, "deg", joint, text))
    return tuple(found)


def nearest_turn(angle_deg: float, low_deg: float, high_deg: float, near_deg: float) -> float:
    """The angle plus whole turns: inside the range if it can be, there the nearest to `near_deg`; unchanged when
    it is inside already or never is."""
    if low_deg <= angle_deg <= high_deg:
        return angle_deg
    return _turned(angle_deg, low_deg, high_deg, near_deg)


def _turned(angle_deg: float, low_deg: float, high_deg: float, near_deg: float) -> float:
    middle = 0.5 * (low_deg + high_deg)
    turned = angle_deg - _TURN_DEG * round((angle_deg - middle) / _TURN_DEG)
    if high_deg - low_deg <= _TURN_DEG:
        return turned  # the nearest to the middle: inside if any is, else the smallest excess
    candidates = (turned - _TURN_DEG, turned, turned + _TURN_DEG)
    inside = [candidate for candidate in candidates if low_deg <= candidate <= high_deg]
    return min(inside, key=lambda candidate: abs(candidate - near_deg)) if inside else turned


def _order(entry: tuple[bool, float, IkSolution]) -> tuple[bool, float]:
    return entry[0], entry[1]


def _inside_offset(amount_mm: float) -> IkResult:
    text = f"the tip is {amount_mm:.4g} mm nearer to the waist axis than its sideways offset allows"
    shortfall = Shortfall(ShortfallKind.INSIDE_OFFSET, amount_mm, "mm", None, text)
    return IkResult(IkStatus.UNREACHABLE, None, (), text, (shortfall,))


def _unreachable(too_far_mm: float, too_near_mm: float) -> IkResult:
    if too_far_mm <= too_near_mm:
        text = f"the wrist centre is {too_far_mm:.4g} mm beyond the stretched arm (a2 + a3)"
        shortfall = Shortfall(ShortfallKind.TOO_FAR, too_far_mm, "mm", None, text)
    else:
        text = f"the wrist centre is {too_near_mm:.4g} mm inside the folded arm (|a2 - a3|)"
        shortfall = Shortfall(ShortfallKind.TOO_NEAR, too_near_mm, "mm", None, text)
    return IkResult(IkStatus.UNREACHABLE, None, (), shortfall.text, (shortfall,))


def _singular(
    best: IkSolution, solutions: tuple[IkSolution, ...], radius_mm: float, no_waist: bool, no_shoulder: bool
) -> IkResult:
    found: list[Shortfall] = []
    if radius_mm < SINGULAR_RADIUS_MM:
        text = "the tip is on the waist axis (r = 0)"
        if no_waist:
            text += f": any waist angle reaches it, {best.q_deg[0]:.4f} deg is kept"
        found.append(Shortfall(ShortfallKind.WAIST_UNDETERMINED, radius_mm, "mm", None, text))
    if no_shoulder:
        text = f"the wrist centre is on the shoulder axis: {best.q_deg[1]:.4f} deg is kept"
        found.append(Shortfall(ShortfallKind.SHOULDER_UNDETERMINED, 0.0, "mm", None, text))
    sine = abs(sin(radians(best.q_deg[2])))
    if sine < SINGULAR_SINE:
        word = "stretched" if cos(radians(best.q_deg[2])) > 0 else "folded"
        text = f"the elbow is {word} (s3 = 0): the tip cannot move along the arm"
        found.append(Shortfall(ShortfallKind.ELBOW_STRAIGHT, sine, "", None, text))
    if not found:
        return IkResult(IkStatus.OK, best, solutions)
    reason = "; ".join(shortfall.text for shortfall in found)
    return IkResult(IkStatus.SINGULAR, best, solutions, reason, tuple(found))


def order_by_distance(solutions: Sequence[IkSolution], seed_deg: Joints, geometry: ArmGeometry) -> list[IkSolution]:
    """Solutions inside the limits first, then by `joint_distance` to the seed (5,) deg."""

    def key(solution: IkSolution) -> tuple[bool, float]:
        return (not solution.in_limits, joint_distance(geometry, solution.q_deg, seed_deg))

    return sorted(solutions, key=key)


def joint_distance(geometry: ArmGeometry, q_deg: Joints, other_deg: Joints) -> float:
    """Distance of two configurations in s: sqrt(sum ((q_i - p_i) / vmax_i)^2), each joint in units of its speed."""
    return sqrt(
        sum(
            (weight * (angle - other)) ** 2
            for weight, angle, other in zip(geometry.weights, q_deg, other_deg, strict=True)
        )
    )
