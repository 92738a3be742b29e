"""Motion on a board: playing planned pieces with an exact mirror of where the arm is, and homing on the switches."""

from rm501_host.motion.homing import HomedJoint, Homing, HomingError
from rm501_host.motion.live import LivePath, Missed
from rm501_host.motion.play import BrokenOff, Progress
from rm501_host.motion.runs import PieceRuns
from rm501_host.motion.stream import MotionStream

__all__ = [
    "BrokenOff",
    "HomedJoint",
    "Homing",
    "HomingError",
    "LivePath",
    "Missed",
    "MotionStream",
    "PieceRuns",
    "Progress",
]
