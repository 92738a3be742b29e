"""From the ideal law to integer segments, exact to the last bit."""

from .backlash import NO_OFFSETS, OffsetLaw, play_columns
from .horizon import Horizon, stop_horizon
from .segmenter import PlannedSegment, Segmenter

__all__ = ["NO_OFFSETS", "Horizon", "OffsetLaw", "PlannedSegment", "Segmenter", "play_columns", "stop_horizon"]
