"""The person at the arm: presses switches, watches what really turns, and answers what the commissioning asks."""

from __future__ import annotations

from dataclasses import dataclass, field

JOINTS = ("waist", "shoulder", "elbow", "pitch", "roll")
SEEN_DEG = 1.0
"""What an eye sees."""


@dataclass(slots=True)
class Watching:
    """The joints' true angles while a step is made: the first joint that turns by a degree, and how far any went."""

    start_deg: tuple[float, ...]
    first: tuple[str, int] | None = None
    farthest_deg: list[float] = field(default_factory=lambda: [0.0] * 5)

    def look(self, now_deg: tuple[float, ...]) -> None:
        """Take the angles of this moment."""
        for joint, (now, start) in enumerate(zip(now_deg, self.start_deg, strict=True)):
            moved = now - start
            if self.first is None and abs(moved) >= SEEN_DEG:
                self.first = (JOINTS[joint], 1 if moved > 0 else -1)
            self.farthest_deg[joint] = max(self.farthest_deg[joint], abs(moved))

    def answer(self, asked: str) -> str:
        """What a person says who was asked about the joint `asked`, commanded in its positive direction."""
        if self.first is None:
            return "nothing"
        joint, sign = self.first
        if asked in ("waist", "shoulder", "elbow"):
            if joint != asked:
                return "another-joint"
            return "right" if sign > 0 else "wrong-way"
        if joint == "pitch":
            return "hand-up" if sign > 0 else "hand-down"
        return ("turned-right" if sign > 0 else "turned-left") if joint == "roll" else "another-joint"
