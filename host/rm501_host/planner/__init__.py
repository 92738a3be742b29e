"""From moves to the fastest ideal law under every limit of the arm."""

from .errors import JointLimitError, OrientationError, PlanError, UnreachableError
from .joint_moves import plan_joint_move
from .limits import Limits
from .pieces import Action, EventKind, Law, Piece, PieceEvent, PieceKind
from .plan import LimitRatios, Plan, PlanSamples
from .planner import Planner
from .profiles import PiecewisePolynomial, cubic, fastest_lspb, lspb, quintic, via_spline
from .run_back import plan_run_back
from .timed import plan_timed

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
    "PiecewisePolynomial",
    "Plan",
    "PlanError",
    "PlanSamples",
    "Planner",
    "UnreachableError",
    "cubic",
    "fastest_lspb",
    "lspb",
    "plan_joint_move",
    "plan_run_back",
    "plan_timed",
    "quintic",
    "via_spline",
]
