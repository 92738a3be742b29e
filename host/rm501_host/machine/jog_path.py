"""The way of a Cartesian jog: straight, in closed form, wherever the arm can follow; damped around its singularities.

A jog is a direction of the tool, held for as long as the arm can go that way. Its way is made before it starts, from
where the arm stands to its end, of two kinds of parts::

    straight    tool on its line, joints by the closed form: no deviation. A part ends where the manipulability of the
                weighted task Jacobian falls below w0 (within about 6 mm of the waist axis, 1.5 deg of a stretched arm)
    damped      there dq/dt = (A^T A + l^2 I)^-1 A^T b, with b the wanted direction and l growing from 0 at w0 to l0 in
                the singularity (Nakamura, Hanafusa 1986): the joints stay slow, the tool gives way as little as that
                costs. Integrated by Runge-Kutta with steps of at most 0.4 deg, joined by a spline

Back outside, the line goes on from where the tool is and returns to the wanted one in a smooth curve. At both borders
l is 0, so that the joints' rates are continuous all along; the time law does the rest, under every limit.

The way ends at a joint limit, a keep-out zone, where its line leaves the reach of the arm, or where damping has no
progress left to give: it would advance at less than `LEAST_PROGRESS` of the wanted speed, or three times faster
sideways than onwards (as fast, once it is `FREE_DEVIATION_MM` off its line), or is off by `MOST_DEVIATION_MM`. The
reason is kept. The line is left only where it goes on behind the singularity: an arm that is stretched out stops on its
line, where damping would begin, 0.03 mm before the edge of its reach, and comes back as it went.

What is held besides the place: pitch and roll of the arm. Only where programs give orientations in the room (XYZABC)
and the tool is vertical, the hand keeps its direction in the room while the waist turns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import JOINT_NAMES
from rm501_host.kinematics import Arm, Branch
from rm501_host.kinematics.velocity_control import default_weights, jog_damping
from rm501_host.kinematics.velocity_inverse import damped_rates
from rm501_host.machine.jog_elements import JOG_SOURCE, Heading, Straight, spline_elements
from rm501_host.planner.elements import Element, Space
from rm501_host.preflight.keep_out import KeepOut

Array = NDArray[np.float64]

LEAST_PROGRESS = 0.03
"""Of the wanted speed; below it a person would see no motion any more."""
FREE_DEVIATION_MM = 5.0
"""What passing the waist axis may cost."""
EDGE_DEVIATION_MM = 0.05
"""What the tool may be off a point that is out of reach before its line is given up: less than the arm repeats."""
MOST_DEVIATION_MM = 10.0
MOST_DEVIATION_DEG = 15.0
_SAMPLE = 0.5
"""Spacing of the samples of a straight part, mm or deg; finer around its end."""
_CHUNK = 128
_LARGEST_STEP_DEG = 0.4
"""Largest turn of a joint in one step of the integration."""
_LARGEST_STEP = 0.5
_LARGEST_JUMP_DEG = 40.0
"""A joint that turns farther between two samples of a straight part has passed a singularity."""
_FREE_RATIO = 3.0
_PARTS = 12
_STEPS = 4000
_RETURN = 6.0
"""Length of the return to the line, in deviations: its steepest slope is 15/8 of 1/6, 17 deg off the line."""
_SHORTEST_RETURN_MM = 5.0
_LEAVE = 1.05
"""The damped part ends a little outside the border, so that the next does not begin at once."""
_SHORTEST_PART = 1e-6
_SHORTEST_STEP = 1e-3
_BISECTIONS = 20
_LIMIT_SLACK_DEG = 1e-7


class Blocked(NamedTuple):
    """Why a way ends: at a singularity (which damping may pass) or for good."""

    at_singularity: bool
    text: str


_BEYOND_REACH = Blocked(False, "the line leaves the reach of the arm; jog another way")


@dataclass(slots=True)
class JogPath:
    """The elements of the way, how far along the wanted direction it leads (mm or deg), why it ends there, and how
    far damping takes the tool off its line.
    """

    elements: list[Element] = field(default_factory=list)
    reach: float = 0.0
    reason: str = ""
    deviation_mm: float = 0.0
    deviation_deg: float = 0.0

    def copy(self) -> JogPath:
        """Another one with the same parts."""
        return replace(self, elements=list(self.elements))

    @property
    def is_damped(self) -> bool:
        """Whether a part of it is."""
        return any(element.source.line for element in self.elements)


class JogWalker:
    """Finds the way of a jog for one arm; `keep_out` may be empty."""

    def __init__(self, arm: Arm, keep_out: KeepOut) -> None:
        self._arm = arm
        self._keep_out = keep_out
        weights = default_weights(arm.geometry)
        self._task, self._joints = weights.task, weights.joints
        self._damping = jog_damping()
        self._low, self._high = arm.limits_deg
        self._heeds_zones = not keep_out.is_empty

    def walk(self, start_deg: Array, heading: Heading, farthest: float) -> JogPath:
        """The way from joints (5,) along `heading`, at most `farthest` (mm or deg)."""
        q = np.array(start_deg, dtype=np.float64)
        # a zone that the arm already stands in must not keep it from getting out
        self._heeds_zones = self._zone(q[None]) is None and not self._keep_out.is_empty
        path = JogPath()
        wanted = self._task_of(q, heading)
        for _ in range(_PARTS):
            blocked, q = self._straight(path, q, wanted, heading, farthest)
            if blocked is not None and blocked.at_singularity:
                before = path.copy()
                blocked, q = self._damped(path, q, wanted, heading, farthest)
                if blocked is _BEYOND_REACH and before.elements:
                    # damping does not lead back to the line: the way ends where it would begin
                    path = before
            elif blocked is None and path.reach < farthest - _SHORTEST_PART:
                continue
            if blocked is not None or path.reach >= farthest - _SHORTEST_PART:
                path.reason = "" if blocked is None else blocked.text
                return path
        path.reason = "the way crosses singularities too often"
        return path

    # ------------------------------------------------------------------------------------------------ straight

    def _straight(
        self, path: JogPath, q: Array, wanted: Array, heading: Heading, farthest: float
    ) -> tuple[Blocked | None, Array]:
        """Go on straight from joints q as far as possible; the joints there, and why no farther."""
        if self._manipulability(q[None], heading)[0] < self._damping.threshold:
            return Blocked(True, ""), q
        here = self._task_of(q, heading)
        offset = here - (wanted + path.reach * heading.direction)
        size = max(float(np.linalg.norm(offset[:3])), 5.0 * float(np.abs(offset[3:]).max()))
        fade = max(_SHORTEST_RETURN_MM, _RETURN * size)
        pose_task = self._pose_task(q)
        radius = self._wrist_radius(q)
        curve = Straight(
            pose_task - offset, heading, offset, fade, radius, complex(pose_task[0], pose_task[1]) - radius
        )
        branch = self._arm.branch_of(q)
        left = farthest - path.reach
        done, last, blocked = 0.0, q, None
        while done < left and blocked is None:
            s = np.minimum(done + _SAMPLE * np.arange(1, _CHUNK + 1), left)
            s = s[: int(np.searchsorted(s, left)) + 1]
            good, joints, blocked = self._good(curve, branch, s, last, heading)
            if blocked is not None:
                low = s[good - 1] if good else done
                before = joints[good - 1] if good else last
                for _ in range(5):  # 32^5 parts of a sample
                    fine = np.linspace(low, s[good], 33)[1:]
                    good, joints, found = self._good(curve, branch, fine, before, heading)
                    blocked = found or blocked
                    s = fine
                    if found is None:
                        good -= 1
                    if good:
                        low, before = fine[good - 1], joints[good - 1]
                done, last = float(low), before
            else:
                done, last = float(s[-1]), joints[-1]
        if done > _SHORTEST_PART:
            element = Element(Space.TASK, done, np.zeros((4, 5)), JOG_SOURCE, curve=curve, branch=branch)
            path.elements.append(element)
            path.reach += done
        return blocked, last

    def _good(
        self, curve: Straight, branch: Branch, s: Array, before: Array, heading: Heading
    ) -> tuple[int, Array, Blocked | None]:
        """How many of the samples the arm can follow, its joints there (n, 5), and why not the next."""
        values, _, _ = curve.evaluate(s)
        q, _ = self._arm.ik_batch(values[:, :3], values[:, 3], values[:, 4], branch, float(before[0]))
        out = np.isnan(q).any(axis=1)
        q = np.where(np.isnan(q), before, q)
        steps = np.diff(np.concatenate((before[None], q)), axis=0)
        turns = 360.0 * np.rint(steps / 360.0)
        turns[:, 4] = 0.0
        q = q - np.cumsum(turns, axis=0)
        jump = np.abs(steps - turns).max(axis=1) > _LARGEST_JUMP_DEG
        weak = out | jump | (self._manipulability(q, heading) < self._damping.threshold)
        over = np.maximum(self._low - q, q - self._high).max(axis=1)
        beyond = over > _LIMIT_SLACK_DEG
        bad = np.flatnonzero(weak | beyond)
        count = int(bad[0]) if len(bad) else len(s)
        entered = self._zone(q[:count])
        if entered is not None:
            return entered[0], q, Blocked(False, entered[1])
        if count == len(s):
            return count, q, None
        if beyond[count] and not weak[count]:
            return count, q, Blocked(False, self._limit_text(q[count]))
        return count, q, Blocked(True, "")

    # ------------------------------------------------------------------------------------------------- damped

    def _damped(
        self, path: JogPath, q: Array, wanted: Array, heading: Heading, farthest: float
    ) -> tuple[Blocked | None, Array]:
        """Go on damped from joints q until it can be straight again (None), or must end."""
        knots, joints, slopes = [0.0], [q], [self._rate(q, heading)[0]]
        reach, blocked, left_zone = path.reach, None, False
        for _ in range(_STEPS):
            rate, progress = self._rate(q, heading)
            blocked = self._stuck(q, rate, progress, wanted + reach * heading.direction, heading)
            if blocked is not None or left_zone or reach >= farthest:
                break
            step = min(_LARGEST_STEP, _LARGEST_STEP_DEG / max(float(np.abs(rate).max()), 1e-9))
            step = min(step, (farthest - reach) / max(progress, LEAST_PROGRESS) + _SHORTEST_PART)
            new_q, gained = self._runge_kutta(q, heading, step)
            if not self._within(new_q):
                blocked = Blocked(False, self._limit_text(new_q))
                step, new_q, gained = self._up_to_the_limit(q, heading, step)
                if step < _SHORTEST_STEP:
                    break
            entered = self._zone(new_q[None])
            if entered is not None:
                blocked = Blocked(False, entered[1])
                break
            q, reach = new_q, reach + gained
            knots.append(knots[-1] + step)
            joints.append(q)
            slopes.append(self._rate(q, heading)[0])
            off = self._task_of(q, heading) - (wanted + reach * heading.direction)
            path.deviation_mm = max(path.deviation_mm, float(np.linalg.norm(off[:3])))
            path.deviation_deg = max(path.deviation_deg, float(np.abs(off[3:]).max()))
            if blocked is not None:
                break
            left_zone = self._manipulability(q[None], heading)[0] > _LEAVE * self._damping.threshold
        else:
            blocked = Blocked(False, "the singularity there is too long to pass")
        if len(knots) > 1:
            path.elements.extend(spline_elements(np.array(knots), np.array(joints), slopes[0], slopes[-1]))
            path.reach = reach
        return blocked, q

    def _rate(self, q: Array, heading: Heading) -> tuple[Array, float]:
        """dq/ds (5,) in deg per unit of the commanded way, and how much of that unit the tool gets on."""
        matrix = self._jacobian(q[None], heading)[0]
        wanted = heading.direction.copy()
        wanted[3:] = np.radians(wanted[3:])
        a = self._task[:, None] * matrix / self._joints
        b = self._task * wanted
        damping = self._damping.factor(abs(float(np.linalg.det(a))))
        y = damped_rates(a, b, damping)
        progress = float((a @ y) @ b) / float(b @ b)
        return np.degrees(y / self._joints), progress

    def _runge_kutta(self, q: Array, heading: Heading, step: float) -> tuple[Array, float]:
        r1, g1 = self._rate(q, heading)
        r2, g2 = self._rate(q + 0.5 * step * r1, heading)
        r3, g3 = self._rate(q + 0.5 * step * r2, heading)
        r4, g4 = self._rate(q + step * r3, heading)
        return q + step / 6.0 * (r1 + 2.0 * r2 + 2.0 * r3 + r4), step / 6.0 * (g1 + 2.0 * g2 + 2.0 * g3 + g4)

    def _stuck(self, q: Array, rate: Array, progress: float, line: Array, heading: Heading) -> Blocked | None:
        """Why damping leads no farther from joints q, or None. `line` (5,): the point of the wanted line that the tool
        is nearest to.
        """
        what = " and ".join(str(s.kind.value) for s in self._arm.singularities(q)) or "a singularity"
        off = self._task_of(q, heading) - line
        if np.linalg.norm(off[:3]) > EDGE_DEVIATION_MM and not self._reaches(line, q):
            return _BEYOND_REACH
        is_edge = not self._reaches(line + heading.direction, q)
        if progress < LEAST_PROGRESS:
            return _BEYOND_REACH if is_edge else Blocked(False, f"no way on: {what}")
        moved = self._jacobian(q[None], heading)[0] @ np.radians(rate)
        wanted = heading.direction.copy()
        wanted[3:] = np.radians(wanted[3:])
        sideways = float(np.linalg.norm(self._task * (moved - progress * wanted)))
        onwards = progress * float(np.linalg.norm(self._task * wanted))
        is_free = float(np.linalg.norm(off[:3])) < FREE_DEVIATION_MM
        if sideways > (_FREE_RATIO if is_free else 1.0) * onwards:
            return _BEYOND_REACH if is_edge else Blocked(False, f"only sideways from here: {what}")
        if np.linalg.norm(off[:3]) > MOST_DEVIATION_MM or np.abs(off[3:]).max() > MOST_DEVIATION_DEG:
            return Blocked(False, f"too far off the line: {what}")
        return None

    def _reaches(self, line: Array, q: Array) -> bool:
        """Whether a point of the line (5,) is within reach as the arm stands, joint limits aside: not with the waist
        turned round.
        """
        branch = self._arm.branch_of(q)
        found, _ = self._arm.ik_batch(line[None, :3], line[None, 3], np.zeros(1), branch, float(q[0]))
        return not np.isnan(found).any()

    # ------------------------------------------------------------------------------------------------- the arm

    def _pose_task(self, q: Array) -> Array:
        pose = self._arm.fk(q)
        return np.array([*pose.xyz_mm, pose.pitch_deg, pose.roll_deg])

    def _task_of(self, q: Array, heading: Heading) -> Array:
        """x, y, z, pitch, and roll less what it owes to the waist, (5,)."""
        task = self._pose_task(q)
        task[4] -= heading.waist_share * q[0]
        return task

    def _wrist_radius(self, q: Array) -> complex:
        """The wrist centre seen from the waist axis, mm: turns with the waist; never quite 0."""
        geometry = self._arm.geometry
        radius = geometry.a2_mm * np.cos(np.radians(q[1])) + geometry.a3_mm * np.cos(np.radians(q[1] + q[2]))
        safe = radius if abs(radius) > 1e-9 else 1e-9
        return complex(safe * np.exp(1j * np.radians(q[0])))

    def _jacobian(self, q: Array, heading: Heading) -> Array:
        matrices = self._arm.task_jacobian_batch(q)
        if heading.waist_share:
            matrices = matrices.copy()
            matrices[:, 4, 0] -= heading.waist_share
        return matrices

    def _manipulability(self, q: Array, heading: Heading) -> Array:
        """Product of the singular values of the weighted task Jacobian at joints (n, 5), (n,)."""
        a = self._task[:, None] * self._jacobian(q, heading) / self._joints
        result: Array = np.abs(np.linalg.det(a))
        return result

    def _zone(self, q: Array) -> tuple[int, str] | None:
        if not self._heeds_zones or not len(q):
            return None
        found = self._keep_out.first_entry(self._arm, q, 0.0)
        return None if found is None else (found[0], found[1])

    def _limit_text(self, q: Array) -> str:
        beyond = np.maximum(self._low - q, q - self._high)
        joint = int(np.argmax(beyond))
        limit = self._low[joint] if q[joint] < self._low[joint] else self._high[joint]
        return f"{JOINT_NAMES[joint]} is at its limit {limit:g} deg"

    def _within(self, q: Array) -> bool:
        return bool(((q >= self._low) & (q <= self._high)).all())

    def _up_to_the_limit(self, q: Array, heading: Heading, step: float) -> tuple[float, Array, float]:
        """The longest step from joints q that stays within the limits, where it leads, and what it gains."""
        low, high = 0.0, step
        best = (0.0, q, 0.0)
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            new_q, gained = self._runge_kutta(q, heading, middle)
            if self._within(new_q):
                low, best = middle, (middle, new_q, gained)
            else:
                high = middle
        return best
