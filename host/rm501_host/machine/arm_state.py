"""What the machine knows about the arm, and how far that may be trusted.

The board says which motors' counts are trusted. The host may trust that only when it is the same boot and the same
configuration under which those counts were defined: the position file remembers both. Otherwise every joint counts as
unhomed until it has homed again; the file remembers that, too, for whoever reads it next.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import msgspec
import numpy as np

from rm501_host.config import JOINT_NAMES, MOTOR_NAMES, Config
from rm501_host.kinematics import Arm
from rm501_host.planner import Limits
from rm501_host.storage import PositionFile, PositionRecord
from rm501_protocol.enums import HandState
from rm501_protocol.messages import Identify, Status

_ARM_MOTORS = 0b11111
_WRIST_MOTORS = 0b11000
_PLACES = (*JOINT_NAMES, *(f"{name} motor" for name in MOTOR_NAMES[3:]))
_EVERY_JOINT = frozenset(range(len(JOINT_NAMES)))
_UNKNOWN_STEPS = (0, 0, 0, 0, 0, 0)


class ArmState:
    """Positions, trust and the position file."""

    def __init__(self, arm: Arm, config: Config, file: PositionFile, utc: Callable[[], str]) -> None:
        self.arm = arm
        self._config = config
        self._file = file
        self._utc = utc
        self._digest = zlib.crc32(msgspec.json.encode(config))
        self._boot_id = 0
        self._contradicted_boot: int | None = None
        self._vetoed: set[int] = set()
        self._status: Status | None = None
        limits = Limits.from_config(config)
        self._columns = limits.play_columns
        self._places = [name for name, play in zip(_PLACES, limits.backlash_deg, strict=True) if play > 0.0]
        self.leads_deg: tuple[float, ...] = (0.0,) * len(_PLACES)
        """How far the motors are ahead at each place of play; 0, the middle, where that is not known."""

    @property
    def warning(self) -> str | None:
        """What is wrong with the position file, None when nothing is."""
        return self._file.warning

    @property
    def boot_id(self) -> int:
        """Which boot of the board the newest session was with, 0 before the first."""
        return self._boot_id

    def connected(self, identify: Identify, status: Status) -> str:
        """A session is up; returns a sentence for the log on what is trusted and why."""
        self._boot_id = identify.boot_id
        self._status = status
        record = self._file.read()
        self._vetoed = set()
        play = self._take_over_offsets(record, identify, status)
        reason = None
        if identify.boot_id == self._contradicted_boot:
            reason = "the board has contradicted itself since it was switched on"
        elif record is None:
            reason = "there is no usable position file"
        elif record.boot_id != identify.boot_id:
            reason = "the position file belongs to another boot of the board"
        elif record.config_hash != self._digest:
            reason = "the position file belongs to another configuration"
        else:
            self._vetoed = set(record.vetoed) & _EVERY_JOINT
        if reason is not None:
            self._vetoed = set(_EVERY_JOINT)
        if not status.trusted_mask & _ARM_MOTORS:
            return "the board trusts no position: home every joint"
        if reason is not None:
            return f"{reason}: nothing is trusted, home every joint"
        if self._vetoed:
            names = ", ".join(JOINT_NAMES[joint] for joint in sorted(self._vetoed))
            return f"same boot and configuration, but not trusted before and not homed since: {names}; home them{play}"
        return f"same boot, same configuration: the joints that the board trusts stay homed{play}"

    def _take_over_offsets(self, record: PositionRecord | None, identify: Identify, status: Status) -> str:
        """Set the offsets from the file if it says where the arm still stands; what to say when they are not known."""
        self.leads_deg = (0.0,) * len(_PLACES)
        if not self._places:
            return ""
        if (
            record is not None
            and not record.dirty
            and (record.boot_id, record.config_hash) == (identify.boot_id, self._digest)
            and record.positions_steps[:5] == status.positions_steps[:5]
        ):
            self.leads_deg = record.leads_deg
            return ""
        return (
            f"; on which side of its play each joint stands is not known ({', '.join(self._places)}): "
            "angles may be off by half the play until each has moved by as much"
        )

    def update(self, status: Status) -> None:
        """Take a new status."""
        self._status = status

    def disconnected(self) -> None:
        """The link is gone: what was known is shown on, and nothing is trusted until the next session."""
        self._status = None

    def contradicted(self) -> None:
        """The board reported what cannot be: until it boots again, or every joint is homed, nothing is trusted."""
        self._contradicted_boot = self._boot_id
        self._vetoed = set(_EVERY_JOINT)

    def joint_homed(self, joint: int) -> None:
        """This joint has homed in this session: from here on the board's trust in it counts."""
        self._vetoed.discard(joint)
        if not self._vetoed:
            self._contradicted_boot = None

    @property
    def homed(self) -> tuple[bool, ...]:
        """Per joint: known and trusted."""
        if self._status is None:
            return (False,) * len(JOINT_NAMES)
        mask = self._status.trusted_mask
        wrist = mask & _WRIST_MOTORS == _WRIST_MOTORS
        trusted = (bool(mask & 1), bool(mask & 2), bool(mask & 4), wrist, wrist)
        return tuple(trust and joint not in self._vetoed for joint, trust in enumerate(trusted))

    @property
    def steps(self) -> tuple[int, ...]:
        """Step counts of the motors as commanded."""
        return _UNKNOWN_STEPS if self._status is None else self._status.positions_steps

    @property
    def offsets_deg(self) -> tuple[float, ...]:
        """How much of each joint's motor side is play taken up."""
        return tuple(float(offset) for offset in self._columns @ np.array(self.leads_deg))

    @property
    def joints_deg(self) -> tuple[float, ...]:
        """Joint angles that belong to the step counts (counter coordinates while unhomed)."""
        angles = self.arm.joints_from_motors(np.array(self.steps[:5], dtype=float)) - np.array(self.offsets_deg)
        return tuple(float(angle) for angle in angles)

    @property
    def hand(self) -> str:
        """The hand as commanded."""
        return (HandState.UNKNOWN if self._status is None else HandState(self._status.hand)).name

    def unhomed(self) -> tuple[str, ...]:
        """Names of the joints that are not homed."""
        return tuple(name for name, homed in zip(JOINT_NAMES, self.homed, strict=True) if not homed)

    def save(self, *, dirty: bool) -> bool:
        """Write the position file; False when the disk refuses."""
        return self._file.write(
            PositionRecord(
                dirty=dirty,
                boot_id=self._boot_id,
                config_hash=self._digest,
                positions_steps=self.steps,
                homed=self.homed,
                vetoed=tuple(sorted(self._vetoed)),
                hand=self.hand,
                utc=self._utc(),
                leads_deg=self.leads_deg,
            )
        )
