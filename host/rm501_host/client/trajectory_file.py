"""Timed joint trajectories in files: CSV, our own JSON, and the JSON of a ROS `trajectory_msgs/JointTrajectory`.

CSV      a header, then a row a point: t_s,waist,shoulder,elbow,pitch,roll[,waist_vel,...,roll_vel]; s, deg, deg/s
JSON     {"times_s": [..], "points_deg": [[5]..], "velocities_deg_s": [[5]..]}; velocities may be left out
ROS      {"joint_names": [..], "points": [{"positions": [..], "velocities": [..], "time_from_start": ..}]} in rad;
         the time in s or as {"sec": .., "nanosec": ..}; joints by name, in any order
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from rm501_host.config.schema import JOINT_NAMES
from rm501_host.errors import RefusedError

_COLUMNS = ("t_s", *JOINT_NAMES)
_VELOCITY_COLUMNS = tuple(f"{name}_vel" for name in JOINT_NAMES)


class TrajectoryFileError(RefusedError):
    """A file is no trajectory; the message names the file and the place."""


@dataclass(frozen=True, slots=True)
class TrajectoryFile:
    """Joint angles (n, 5) in deg at times (n,) in s, velocities (n, 5) in deg/s or None."""

    points_deg: list[list[float]]
    times_s: list[float]
    velocities_deg_s: list[list[float]] | None


def read_trajectory(path: Path) -> TrajectoryFile:
    """Read a trajectory; raises TrajectoryFileError naming file and place."""
    try:
        text = path.read_text("utf-8")
        found = _from_csv(text) if path.suffix.lower() == ".csv" else _from_json(text)
    except (ValueError, KeyError, TypeError, msgspec.DecodeError) as error:
        what = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise TrajectoryFileError(f"{path}: {what}; see rm501-host follow --help for the forms") from error
    if not found.times_s:
        raise TrajectoryFileError(f"{path}: there are no points")
    return found


def _from_csv(text: str) -> TrajectoryFile:
    rows = list(csv.reader(text.splitlines()))
    header = tuple(name.strip() for name in rows[0]) if rows else ()
    if header not in (_COLUMNS, _COLUMNS + _VELOCITY_COLUMNS):
        raise ValueError(f"line 1: the columns are {','.join(_COLUMNS)}, and {','.join(_VELOCITY_COLUMNS)} if you like")
    times, points, velocities = [], [], []
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            values = [_finite(value) for value in row]
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        if len(values) != len(header):
            raise ValueError(f"line {number}: {len(values)} values instead of {len(header)}")
        times.append(values[0])
        points.append(values[1:6])
        velocities.append(values[6:])
    return TrajectoryFile(points, times, velocities if len(header) > len(_COLUMNS) else None)


def _from_json(text: str) -> TrajectoryFile:
    data = msgspec.json.decode(text)
    if not isinstance(data, dict):
        raise ValueError("an object is expected")
    if "joint_names" in data:
        return _from_ros(data)
    velocities = data.get("velocities_deg_s")
    return TrajectoryFile(
        [_row(row, f"points_deg[{i}]") for i, row in enumerate(data["points_deg"])],
        [_finite(time_s) for time_s in data["times_s"]],
        None if velocities is None else [_row(row, f"velocities_deg_s[{i}]") for i, row in enumerate(velocities)],
    )


def _from_ros(data: dict[str, Any]) -> TrajectoryFile:
    names = data["joint_names"]
    if sorted(names) != sorted(JOINT_NAMES):
        raise ValueError(f"joint_names are {names}; this arm's are {', '.join(JOINT_NAMES)}")
    order = [names.index(name) for name in JOINT_NAMES]
    times, points, velocities = [], [], []
    for i, point in enumerate(data["points"]):
        positions = _row(point["positions"], f"points[{i}].positions")
        points.append([math.degrees(positions[k]) for k in order])
        when = point["time_from_start"]
        times.append(_finite(when["sec"]) + 1e-9 * _finite(when.get("nanosec", 0)) if isinstance(when, dict) else when)
        if point.get("velocities"):
            rates = _row(point["velocities"], f"points[{i}].velocities")
            velocities.append([math.degrees(rates[k]) for k in order])
    if velocities and len(velocities) != len(points):
        raise ValueError("some points have velocities and some have none")
    return TrajectoryFile(points, [_finite(time_s) for time_s in times], velocities or None)


def _row(values: Any, place: str) -> list[float]:
    if not isinstance(values, list) or len(values) != len(JOINT_NAMES):
        raise ValueError(f"{place}: five joints are expected")
    return [_finite(value) for value in values]


def _finite(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{value!r} is no finite number")
    return number
