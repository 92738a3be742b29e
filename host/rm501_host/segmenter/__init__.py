"""From the ideal law to integer segments, exact to the last bit."""

from .horizon import Horizon, stop_horizon
from .segmenter import PlannedSegment, Segmenter

__all__ = ["Horizon", "PlannedSegment", "Segmenter", "stop_horizon"]
