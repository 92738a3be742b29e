"""From the ideal law to integer segments, exact to the last bit."""

from .segmenter import PlannedSegment, Segmenter

__all__ = ["PlannedSegment", "Segmenter"]
