"""Motion on a board: playing planned pieces with an exact mirror of where the arm is, and homing on the switches."""

from rm501_host.motion.homing import HomedJoint, Homing, HomingError
from rm501_host.motion.runs import PieceRuns
from rm501_host.motion.stream import MotionStream, Progress

__all__ = ["HomedJoint", "Homing", "HomingError", "MotionStream", "PieceRuns", "Progress"]
