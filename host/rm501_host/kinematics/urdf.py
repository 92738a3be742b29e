"""The arm as URDF: for viewers, MoveIt and other tools of that world.

A standard DH link turns first and is displaced after, a URDF joint is displaced first and turns after: so joint i
carries the fixed part of link i-1. Lengths in m, angles in rad, as URDF demands. Joint values are DH angles.

    base_link -waist-> waist_link -shoulder-> upper_arm_link -elbow-> forearm_link -pitch-> wrist_link -roll->
    hand_link -tool (fixed)-> tool0
"""

from __future__ import annotations

from math import pi, radians
from xml.etree import ElementTree

import numpy as np

from rm501_host.config import JOINT_NAMES
from rm501_host.kinematics import rotations
from rm501_host.kinematics.arm import Arm
from rm501_host.kinematics.solids import SolidRadii

LINK_NAMES = ("base_link", "waist_link", "upper_arm_link", "forearm_link", "wrist_link", "hand_link")
_M = 1e-3
Vector = tuple[float, float, float]
_NONE: Vector = (0.0, 0.0, 0.0)


def urdf_text(arm: Arm, name: str = "rm501") -> str:
    """The URDF document of the arm with its present tool, ending in a line feed.

    The format demands an effort limit; the arm's is not known, so it is 0. The velocity limits are those of the
    joints; the wrist motors' common limit has no place in URDF.
    """
    geometry = arm.geometry
    robot = ElementTree.Element("robot", {"name": name})
    radii = SolidRadii()
    quarter: Vector = (pi / 2, 0.0, 0.0)
    z_to_x: Vector = (0.0, pi / 2, 0.0)
    tx, ty, tz = geometry.tcp_mm
    hand_mm = max(tz - radii.hand_mm, 1.0)
    shapes = (
        (geometry.d1_mm, radii.column_mm, (0.0, 0.0, geometry.d1_mm / 2), _NONE),
        None,
        (geometry.a2_mm, radii.upper_arm_mm, (geometry.a2_mm / 2, 0.0, 0.0), z_to_x),
        (geometry.a3_mm, radii.forearm_mm, (geometry.a3_mm / 2, 0.0, 0.0), z_to_x),
        None,
        (hand_mm, radii.hand_mm, (0.0, 0.0, hand_mm / 2), _NONE),
    )
    for link, shape in zip(LINK_NAMES, shapes, strict=True):
        element = ElementTree.SubElement(robot, "link", {"name": link})
        if shape is not None and shape[0] > 0:
            length_mm, radius_mm, centre_mm, rpy = shape
            for tag in ("visual", "collision"):
                part = ElementTree.SubElement(element, tag)
                _origin(part, centre_mm, rpy)
                outline = ElementTree.SubElement(part, "geometry")
                size = {"length": _number(length_mm * _M), "radius": _number(radius_mm * _M)}
                ElementTree.SubElement(outline, "cylinder", size)
    ElementTree.SubElement(robot, "link", {"name": "tool0"})
    offsets: tuple[tuple[Vector, Vector], ...] = (
        (_NONE, _NONE),
        ((0.0, 0.0, geometry.d1_mm), quarter),
        ((geometry.a2_mm, 0.0, 0.0), _NONE),
        ((geometry.a3_mm, 0.0, 0.0), _NONE),
        (_NONE, quarter),
    )
    bounds = arm.motors.velocity_limits.bounds
    for index, (joint, (xyz_mm, rpy)) in enumerate(zip(JOINT_NAMES, offsets, strict=True)):
        element = _joint(robot, joint, "revolute", LINK_NAMES[index], LINK_NAMES[index + 1])
        _origin(element, xyz_mm, rpy)
        ElementTree.SubElement(element, "axis", {"xyz": "0 0 1"})
        limit = {
            "lower": _number(radians(geometry.min_deg[index])),
            "upper": _number(radians(geometry.max_deg[index])),
            "velocity": _number(radians(float(bounds[index]))),
            "effort": "0",
        }
        ElementTree.SubElement(element, "limit", limit)
    tool = _joint(robot, "tool", "fixed", LINK_NAMES[-1], "tool0")
    roll, pitch, yaw = rotations.rpy_from_matrix(np.array(geometry.tilt).reshape(3, 3))
    _origin(tool, (tx, ty, tz), (radians(roll), radians(pitch), radians(yaw)))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _joint(robot: ElementTree.Element, name: str, kind: str, parent: str, child: str) -> ElementTree.Element:
    element = ElementTree.SubElement(robot, "joint", {"name": name, "type": kind})
    ElementTree.SubElement(element, "parent", {"link": parent})
    ElementTree.SubElement(element, "child", {"link": child})
    return element


def _origin(parent: ElementTree.Element, xyz_mm: Vector, rpy_rad: Vector) -> None:
    xyz = " ".join(_number(length * _M) for length in xyz_mm)
    ElementTree.SubElement(parent, "origin", {"xyz": xyz, "rpy": " ".join(_number(angle) for angle in rpy_rad)})


def _number(value: float) -> str:
    return repr(float(value))
