"""Forward kinematics by plain multiplication of DH matrices, written apart from the product.

Takes the numbers of the DH table, nothing of `rm501_host.kinematics`: what the closed forms are judged by.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def dh_chain(q_deg: Array, d1: float, a2: float, a3: float, d5: float, tool: Array | None = None) -> list[Array]:
    """Frames 0..5 and the tool for joints (n, 5) deg: seven arrays (n, 4, 4), mm."""
    q = np.radians(np.atleast_2d(q_deg))
    table = ((d1, 0.0, 1), (0.0, a2, 0), (0.0, a3, 0), (0.0, 0.0, 1), (d5, 0.0, 0))
    frame = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    chain = [frame]
    for joint, (d, a, quarter_turns) in enumerate(table):
        c, s = np.cos(q[:, joint]), np.sin(q[:, joint])
        zero, one = np.zeros_like(c), np.ones_like(c)
        if quarter_turns:  # alpha = 90 deg
            rows = [[c, zero, s, a * c], [s, zero, -c, a * s], [zero, one, zero, d * one], [zero, zero, zero, one]]
        else:
            rows = [[c, -s, zero, a * c], [s, c, zero, a * s], [zero, zero, one, d * one], [zero, zero, zero, one]]
        link = np.moveaxis(np.array(rows), 2, 0)
        frame = frame @ link
        chain.append(frame)
    chain.append(frame if tool is None else frame @ tool)
    return chain


def dh_pose(q_deg: Array, d1: float, a2: float, a3: float, d5: float) -> tuple[Array, Array]:
    """Tool positions (n, 3) mm and rotations (n, 3, 3) without a tool."""
    last = dh_chain(q_deg, d1, a2, a3, d5)[-1]
    return last[:, :3, 3], last[:, :3, :3]


def geometric_jacobian(chain: list[Array]) -> Array:
    """J (n, 6, 5) by its definition: [z(i-1) x (pe - p(i-1)); z(i-1)]."""
    tip = chain[-1][:, :3, 3]
    columns = []
    for joint in range(5):
        axis, origin = chain[joint][:, :3, 2], chain[joint][:, :3, 3]
        columns.append(np.concatenate((np.cross(axis, tip - origin), axis), axis=1))
    return np.stack(columns, axis=2)
