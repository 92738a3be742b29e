"""A path as the joints see it: any mixture of elements evaluated to joint angles and their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rm501_host.kinematics import Arm, Branch

from .elements import Array, ElementTable, Indices
from .errors import UnreachableError
from .jointspace import joint_derivatives, tool_derivatives


@dataclass(frozen=True, slots=True, eq=False)
class PathPoints:
    """Points of a path: joints (n, 5) in deg and their first and second derivatives with respect to s, and those of
    the tool centre point (n, 3) in mm.
    """

    q_deg: Array
    q1: Array
    q2: Array
    p1: Array
    p2: Array


def joints_along(arm: Arm, table: ElementTable, index: Indices, s: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Joint angles (n, 5) in deg at (element index, s), and whether the point can be reached, (n,)."""
    values, _, _ = table.evaluate(index, s)
    return joints_at(arm, table, index, values)


def joints_at(arm: Arm, table: ElementTable, index: Indices, values: Array) -> tuple[Array, NDArray[np.bool_]]:
    """As `joints_along`, where what the elements are there, `values` (n, 5), is known already."""
    task = ~table.is_joint[index]
    ok = np.ones(len(values), dtype=bool)
    if not task.any():
        return values, ok
    q_deg = values.copy()
    branches = table.branch[index]
    for branch in np.unique(branches[task]):
        chosen = task & (branches == branch)
        rows = slice(None) if chosen.all() else chosen
        y = values[rows]
        found, _ = arm.ik_batch(y[:, :3], y[:, 3], y[:, 4], Branch(int(branch)))
        q_deg[rows] = found
        # outside the joint ranges is somebody else's question: here only whether there are angles at all
        ok[rows] = ~np.isnan(found[:, 0])
    return q_deg, ok


def path_points(arm: Arm, table: ElementTable, index: Indices, s: Array) -> PathPoints:
    """Everything that the limits need at (element index, s), each (n,).

    Raises UnreachableError for the first point that no joint angles of its branch reach.
    """
    values, y1, y2 = table.evaluate(index, s)
    q_deg, ok = joints_at(arm, table, index, values)
    if not ok.all():
        raise unreachable(arm, table, index, s, int(np.flatnonzero(~ok)[0]))
    joint = table.is_joint[index]
    if joint.all():
        p1, p2 = tool_derivatives(arm, q_deg, y1, y2)
        return PathPoints(q_deg, y1, y2, p1, p2)
    with np.errstate(over="ignore", invalid="ignore"):
        if not joint.any():
            q1, q2 = joint_derivatives(arm, q_deg, y1, y2, values[:, :3])
            return PathPoints(q_deg, q1, q2, y1[:, :3], y2[:, :3])
        task = ~joint
        q1, q2, p1, p2 = y1.copy(), y2.copy(), y1[:, :3].copy(), y2[:, :3].copy()
        q1[task], q2[task] = joint_derivatives(arm, q_deg[task], y1[task], y2[task], values[task, :3])
        p1[joint], p2[joint] = tool_derivatives(arm, q_deg[joint], y1[joint], y2[joint])
    return PathPoints(q_deg, q1, q2, p1, p2)


def unreachable(arm: Arm, table: ElementTable, index: Indices, s: Array, point: int) -> UnreachableError:
    """The error for a point that `arm.ik_batch` could not solve: names what is missing and the remedy."""
    element = table.elements[index[point]]
    values, _, _ = element.evaluate(s[point : point + 1])
    x, y, z, pitch, roll = (float(value) for value in values[0])
    result = arm.ik((x, y, z), pitch, roll)
    amount = result.shortfalls[0].amount if result.shortfalls else None
    reason = result.reason or "the arm would have to change its branch on the way"
    return UnreachableError(
        f"({x:.3f}, {y:.3f}, {z:.3f}) mm at pitch {pitch:.2f} deg cannot be reached: {reason}",
        source=element.source,
        place_mm=float(s[point]),
        amount=amount,
        remedy="bring the path nearer, tilt the tool, or go there with a joint move (G0)",
    )
