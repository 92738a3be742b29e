"""An independent judge of plans: nothing of the planner's own arithmetic is used.

Forward kinematics is the product of DH matrices, rates and accelerations are differences of the 1 ms samples of q,
motors come from the configuration's numbers, the path is compared with the program's own geometry, and segments are
played step by step in integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from rm501_host.config import Config
from rm501_host.moves import ArcMove, LinearMove, Move
from rm501_host.planner import Piece
from rm501_host.segmenter import PlannedSegment
from rm501_protocol.enums import SegmentFlag

Array = NDArray[np.float64]


def tool_positions(config: Config, q_deg: Array) -> Array:
    """Tool centre points (n, 3) in the base frame, multiplying one DH matrix after another; no tool offsets."""
    geometry = config.geometry
    rows = (
        (geometry.d1_mm, 0.0, 90.0),
        (0.0, geometry.a2_mm, 0.0),
        (0.0, geometry.a3_mm, 0.0),
        (0.0, 0.0, 90.0),
        (geometry.d5_mm + config.tool.length_mm, 0.0, 0.0),
    )
    total = np.broadcast_to(np.eye(4), (len(q_deg), 4, 4))
    for joint, (d, a, alpha_deg) in enumerate(rows):
        theta = np.radians(q_deg[:, joint])
        ca, sa = np.cos(radians(alpha_deg)), np.sin(radians(alpha_deg))
        link = np.zeros((len(q_deg), 4, 4))
        link[:, 0, 0], link[:, 0, 1], link[:, 0, 2] = np.cos(theta), -np.sin(theta) * ca, np.sin(theta) * sa
        link[:, 1, 0], link[:, 1, 1], link[:, 1, 2] = np.sin(theta), np.cos(theta) * ca, -np.cos(theta) * sa
        link[:, 0, 3], link[:, 1, 3] = a * np.cos(theta), a * np.sin(theta)
        link[:, 2, 1], link[:, 2, 2], link[:, 2, 3], link[:, 3, 3] = sa, ca, d, 1.0
        total = total @ link
    return np.ascontiguousarray(total[:, :3, 3])


def motor_matrix(config: Config) -> Array:
    """Steps per joint deg (5, 5)."""
    matrix = np.zeros((5, 5))
    for i, sign in enumerate(config.drive.signs):
        matrix[i, i] = sign
    matrix[3:, 3:] = config.drive.wrist_matrix
    return np.array([motor.steps_per_deg for motor in config.motors.ordered])[:, None] * matrix


@dataclass(frozen=True)
class Judged:
    """Largest ratios to the limits, from differences of equally spaced samples."""

    joint_velocity: float
    joint_acceleration: float
    motor_rate: float
    motor_acceleration: float
    lowest_margin_deg: float

    @property
    def worst(self) -> float:
        return max(self.joint_velocity, self.joint_acceleration, self.motor_rate, self.motor_acceleration)


def judge_samples(config: Config, t_s: Array, q_deg: Array) -> Judged:
    """Ratios from first and second differences. The mean of a limited quantity over an interval is within the limit,
    so a legal law never shows more than 1; a jump of speed shows as an acceleration of jump / dt.
    """
    dt = np.diff(t_s)
    regular = np.abs(dt - dt[0]) < 1e-9
    rates = np.diff(q_deg, axis=0) / dt[:, None]
    both = regular[1:] & regular[:-1]
    accelerations = (np.diff(rates, axis=0) / dt[0])[both] if len(rates) > 1 else np.zeros((0, 5))
    motors = motor_matrix(config)
    joints, drives = config.joints.ordered, config.motors.ordered
    velocity = np.array([j.max_velocity_deg_s for j in joints])
    acceleration = np.array([j.max_acceleration_deg_s2 for j in joints])
    rate = np.array([m.max_rate_steps_s for m in drives])
    motor_acceleration = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in drives])
    margin = min(
        float((q_deg - np.array([j.min_deg for j in joints])).min()),
        float((np.array([j.max_deg for j in joints]) - q_deg).min()),
    )
    return Judged(
        _ratio(rates, velocity),
        _ratio(accelerations, acceleration),
        _ratio(rates @ motors.T, rate),
        _ratio(accelerations @ motors.T, motor_acceleration),
        margin,
    )


def _ratio(values: Array, limits: Array) -> float:
    return float((np.abs(values) / limits).max(initial=0.0))


def programmed_points(start_mm: Array, moves: Sequence[Move], spacing_mm: float = 0.02) -> Array:
    """A dense polyline (n, 3) of the program's own lines and arcs (base frame = program frame)."""
    at = np.array(start_mm, dtype=np.float64)
    points = [at[None]]
    for move in moves:
        if isinstance(move, LinearMove):
            end = np.array(move.target[:3])
            count = max(2, int(np.linalg.norm(end - at) / spacing_mm) + 1)
            points.append(at + (end - at) * np.linspace(0.0, 1.0, count)[:, None])
        elif isinstance(move, ArcMove):
            end = np.array(move.target[:3])
            centre, axis = np.array(move.centre_mm), np.array(move.axis)
            radial = at - centre
            rise = float((end - at) @ axis)
            angle = radians(move.angle_deg)
            count = max(16, int(np.linalg.norm(radial) * abs(angle) / spacing_mm) + 1)
            share = np.linspace(0.0, 1.0, count)[:, None]
            turned = radial * np.cos(angle * share) + np.cross(axis, radial) * np.sin(angle * share)
            points.append(centre + turned + axis * rise * share)
        else:
            continue
        at = end
    return np.concatenate(points)


def path_deviation_mm(tcp_mm: Array, path_mm: Array) -> float:
    """Largest distance of executed points from the programmed polyline.

    scipy's k-d tree finds the nearest vertices; the distance is to the two edges there.
    """
    from scipy.spatial import cKDTree

    keep = np.concatenate((np.array([True]), np.linalg.norm(np.diff(path_mm, axis=0), axis=1) > 1e-12))
    path = path_mm[keep]
    if len(path) == 1:
        return float(np.linalg.norm(tcp_mm - path, axis=1).max())
    _, near = cKDTree(path).query(tcp_mm, k=min(3, len(path)))
    near = np.atleast_2d(near.T).T
    best = np.full(len(tcp_mm), np.inf)
    for column in range(near.shape[1]):
        for side in (-1, 0):
            first = np.clip(near[:, column] + side, 0, len(path) - 2)
            a, step = path[first], path[first + 1] - path[first]
            share = np.clip(np.einsum("ij,ij->i", tcp_mm - a, step) / np.einsum("ij,ij->i", step, step), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(tcp_mm - a - share[:, None] * step, axis=1))
    return float(best.max())


@dataclass(frozen=True)
class PlayedSegments:
    """What playing the segments frame by frame in integers gave."""

    joint_velocity: float
    motor_rate: float
    joint_acceleration: float
    motor_acceleration: float
    largest_speed_jump_steps_s: float
    largest_error_steps: float
    largest_rest_error_steps: float

    @property
    def worst(self) -> float:
        return max(self.joint_velocity, self.joint_acceleration, self.motor_rate, self.motor_acceleration)


def play_segments(config: Config, planned: Sequence[PlannedSegment], pieces: Sequence[Piece]) -> PlayedSegments:
    """Step every segment (p += v; v += a; a += j) and compare with the limits and with the ideal law."""
    frame_s = config.board.base_period_us * len(config.board.table) * 1e-6
    matrix = motor_matrix(config)
    back = np.linalg.inv(matrix)
    joints, drives = config.joints.ordered, config.motors.ordered
    velocity = np.array([j.max_velocity_deg_s for j in joints])
    acceleration = np.array([j.max_acceleration_deg_s2 for j in joints])
    rate = np.array([m.max_rate_steps_s for m in drives])
    motor_acceleration = np.array([m.max_acceleration_deg_s2 * m.steps_per_deg for m in drives])
    worst = np.zeros(4)
    jump = error = rest_error = 0.0
    end_speed = np.zeros(5)
    origin = planned[0].start_frame
    begin_s = pieces[0].start_s
    expected_start = planned[0].start_frame
    positions = list(planned[0].start_q48)
    for item in planned:
        segment = item.segment
        assert item.start_frame == expected_start
        assert segment.start_frames == item.start_frame & 0xFFFFFFFF
        assert list(item.start_q48) == positions
        expected_start = item.end_frame
        n = segment.length_frames
        steps = np.tile(np.array(positions[:5], dtype=np.float64) / 2.0**48, (n + 1, 1))
        speeds, accelerations = np.zeros((2, 5)), np.zeros((2, 5))
        for term in segment.motors:
            p, v, a = positions[term.motor], term.v << 16, term.a << 8
            speeds[0, term.motor] = (v - a / 2 + term.j / 3) / 2.0**48 / frame_s
            accelerations[0, term.motor] = (a - term.j) / 2.0**48 / frame_s**2
            track = np.empty(n + 1)
            track[0] = p / 2.0**48
            for k in range(1, n + 1):
                p += v
                v += a
                a += term.j
                track[k] = p / 2.0**48
            positions[term.motor] = p
            steps[:, term.motor] = track
            speeds[1, term.motor] = (v - a / 2 + term.j / 3) / 2.0**48 / frame_s
            accelerations[1, term.motor] = (a - term.j) / 2.0**48 / frame_s**2
        assert list(item.end_q48) == positions
        jump = max(jump, float(np.abs(speeds[0] - end_speed).max()))
        end_speed = speeds[1]
        if segment.flags & SegmentFlag.ENDS_AT_REST:
            jump = max(jump, float(np.abs(end_speed).max()))
            end_speed = np.zeros(5)
        for values, joint_limits, motor_limits, at in (
            (speeds, velocity, rate, 0),
            (accelerations, acceleration, motor_acceleration, 2),
        ):
            worst[at] = max(worst[at], _ratio(values @ back.T, joint_limits))
            worst[at + 1] = max(worst[at + 1], _ratio(values, motor_limits))
        frames = np.arange(n + 1)
        times = (item.start_frame - origin + frames) * frame_s + begin_s
        ideal = ideal_joints(pieces, times) @ matrix.T
        error = max(error, float(np.abs(steps - ideal).max()))
        if segment.flags & SegmentFlag.ENDS_AT_REST:
            rest_error = max(rest_error, float(np.abs(steps[-1] - ideal[-1]).max()))
    return PlayedSegments(*worst.tolist(), jump, error, rest_error)


def ideal_joints(pieces: Sequence[Piece], times_s: Array) -> Array:
    """Joints (n, 5) of the ideal law at plan times."""
    result = np.zeros((len(times_s), 5))
    for piece in pieces:
        chosen = (times_s >= piece.start_s - 1e-9) & (times_s <= piece.end_s + 1e-9)
        if chosen.any():
            result[chosen] = piece.q_deg(np.clip(times_s[chosen] - piece.start_s, 0.0, piece.duration_s))
    return result
