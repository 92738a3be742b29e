"""From moves to the fastest ideal law under every limit of the arm."""

from .errors import JointLimitError, OrientationError, PlanError, UnreachableError
from .joint_moves import plan_joint_move
from .limits import Limits
from .pieces import Action, EventKind, Law, Piece, PieceEvent, PieceKind
from .plan import LimitRatios, Plan, PlanSamples
from .planner import Planner

__all__ = [
    "Action",
    "EventKind",
    "JointLimitError",
    "Law",
    "LimitRatios",
    "Limits",
    "OrientationError",
    "Piece",
    "PieceEvent",
    "PieceKind",
    "Plan",
    "PlanError",
    "PlanSamples",
    "Planner",
    "UnreachableError",
    "plan_joint_move",
]
