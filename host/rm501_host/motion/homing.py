"""Homing: each joint finds its switch, in sequence, on the board's triggers.

One joint, with the speeds of `[joints.NAME.home]`::

    1  back off     only if the switch is active: move away until it releases, at most the active side's extent
    2  search       toward the switch until it closes; the board latches the edge and ramps to a stop on the way
    3  latch        away, slowly, until it releases: the latched count is the switch
    4  once more    close and release again; both latches must agree within latch_spread_deg
    5  set          the latched place is switch_deg (LinuxCNC's HOME_OFFSET for opposite search and latch directions)
    6  go home      to home_deg, stopped by the switch should it close again, unless ignore_limits is set

Before a joint is homed its angle means nothing, so moves are planned in *counter coordinates*: the joint angles that
the board's step counts would have if zero counts were zero degrees. `offset_deg` leads from there to the true angle.
Motors are set, and with it trusted, once every joint they carry is homed: the two wrist motors only after pitch and
roll both are.

The switch marks one end of where homing may take its joint (LinuxCNC's limit switch that is the home switch, too): an
active one is only ever left, and the home position lies on its open side, so a switch that closes on the way home is
out of place or broken. `ignore_limits` (HOME_IGNORE_LIMITS) says that the home position lies past the switch, as the
pitch's does: then nothing is asked of it on the way home. After homing the switches stop nothing; programs may work
past them.

Guarded travel bounds each move, so a switch that is stuck or cut ends in an error that names it, never in a run into
the end stop without bound.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from rm501_host.config import JOINT_NAMES, Config
from rm501_host.errors import StoppedError
from rm501_host.kinematics import Arm
from rm501_host.motion.offsets import flank_deg
from rm501_host.motion.stream import MotionStream
from rm501_host.planner import Limits, plan_joint_move
from rm501_protocol.board_config import InputId
from rm501_protocol.enums import Edge
from rm501_protocol.messages import TriggerReport
from rm501_protocol.segment import ONE_STEP

_TRAVEL_SHARE = 1.1
"""Search travel over the joint's range: from any pose inside it the switch must come."""
_PAST_SWITCH_DEG = 10.0
"""A stop from 15 deg/s at 20 deg/s2 takes 5.6 deg, and the end stops lie 6 deg beyond: more than this is no longer
the switch.
"""
_WRIST_JOINTS = (3, 4)
_SAME_STEP = 1e-6
_SAME_DEG = 1e-6
"""Latches are whole steps: a spread of exactly the allowed number of steps is allowed, whatever rounding says."""


class HomingError(StoppedError):
    """A joint did not home; `joint` and `input` name it. Its position and that of its motors is not trusted."""

    def __init__(self, joint: str, switch: str, what: str, remedy: str) -> None:
        self.joint = joint
        self.input = switch
        super().__init__(f"homing {joint}: {what} ({switch}); the position is not trusted; {remedy}")


@dataclass(frozen=True, slots=True)
class HomedJoint:
    """How one joint homed: both latches and their spread in deg, counter coordinates, and the correction that
    followed.
    """

    joint: str
    latches_deg: tuple[float, float]
    spread_deg: float
    correction_deg: float


class Homing:
    """Homes joints through a `MotionStream`; `homed` says which joints' angles are true."""

    def __init__(self, stream: MotionStream, arm: Arm, config: Config) -> None:
        self._stream = stream
        self._arm = arm
        self._config = config
        self._offset_deg = [0.0] * len(JOINT_NAMES)
        self.homed = [False] * len(JOINT_NAMES)

    async def home_all(self, on_joint: Callable[[str], None] | None = None) -> list[HomedJoint]:
        """Home every joint in the configured sequence; raises HomingError, StoppedError."""
        joints = self._config.joints.ordered
        order = sorted(range(len(joints)), key=lambda index: joints[index].home.sequence)
        results = []
        for index in order:
            if on_joint is not None:
                on_joint(JOINT_NAMES[index])
            try:
                results.append(await self.home_joint(index))
            except HomingError:
                raise
            except StoppedError as error:
                raise HomingError(
                    JOINT_NAMES[index], joints[index].home.input, f"stopped: {error}", "then home again"
                ) from error
        return results

    async def home_joint(self, index: int) -> HomedJoint:
        """Home one joint (index 0..4) and move it to its home position; raises HomingError, StoppedError."""
        joint = self._config.joints.ordered[index]
        home = joint.home
        self.homed[index] = False
        away = -1.0 if home.active == "above" else 1.0
        past_deg = home.switch_deg - joint.min_deg if away > 0 else joint.max_deg - home.switch_deg
        back_off_deg = max(0.0, past_deg) + _PAST_SWITCH_DEG
        search_deg = _TRAVEL_SHARE * (joint.max_deg - joint.min_deg) + _PAST_SWITCH_DEG
        search, latch = abs(home.search_deg_s), abs(home.latch_deg_s)
        if self._active(index):
            released = await self._seek(index, away * back_off_deg, search, Edge.FALLING)
            if released is None:
                raise self._error(
                    index, f"the switch is active and did not release within {back_off_deg:.1f} deg", "stuck"
                )
        if await self._seek(index, -away * search_deg, search, Edge.RISING) is None:
            raise self._error(index, f"the switch did not close within {search_deg:.1f} deg", "open")
        first_deg = await self._latch(index, away, latch)
        if await self._seek(index, -away * _PAST_SWITCH_DEG, latch, Edge.RISING) is None:
            raise self._error(index, "the switch did not close a second time", "open")
        second_deg = await self._latch(index, away, latch)
        spread_deg = abs(first_deg - second_deg)
        if spread_deg > home.latch_spread_deg + _SAME_DEG:
            raise self._error(
                index,
                f"two latches differ by {spread_deg:.3f} deg, allowed are {home.latch_spread_deg:.3f}",
                "loose",
            )
        before_deg = self._offset_deg[index]
        self._offset_deg[index] = self._released_deg(index, away) - second_deg
        # it stopped still moving away: whatever was commanded before, the link hangs on the flank of that direction
        self._stream.offsets.set(self._flank(index, away))
        self.homed[index] = True
        correction_deg = self._offset_deg[index] - before_deg
        await self._set_positions(index)
        await self._go_home(index)
        return HomedJoint(JOINT_NAMES[index], (first_deg, second_deg), spread_deg, correction_deg)

    async def _latch(self, index: int, away: float, speed_deg_s: float) -> float:
        """Leave the switch slowly; the joint's angle at the release edge, counter coordinates."""
        report = await self._seek(index, away * 2 * _PAST_SWITCH_DEG, speed_deg_s, Edge.FALLING)
        if report is None:
            raise self._error(index, "the switch did not release", "stuck")
        return float(self._arm.joints_from_motors(report.positions_steps[:5])[index]) - self._flank_deg(index, away)

    def _flank(self, index: int, way: float) -> tuple[float, ...]:
        """How far the motors are ahead at every place of play once a joint has taken it up in this direction."""
        return Limits.from_config(self._config).on_the_flank(self._stream.offsets.leads_deg, index, way)

    def _flank_deg(self, index: int, way: float) -> float:
        """The same for the joint's angle."""
        return flank_deg(Limits.from_config(self._config), self._stream.offsets, index, way)

    async def _seek(self, index: int, travel_deg: float, speed_deg_s: float, edge: Edge) -> TriggerReport | None:
        """Move one joint by `travel_deg` at `speed_deg_s` until its switch shows `edge`; None when it never did."""
        start_deg = self._counter_deg()
        target_deg = list(start_deg)
        target_deg[index] += travel_deg
        pieces = plan_joint_move(
            self._arm,
            self._config,
            start_deg,
            target_deg,
            max_velocity_deg_s=speed_deg_s,
            ignore_limits=True,
        )
        switch = InputId[self._config.joints.ordered[index].home.input]
        return await self._stream.play_until(pieces, switch, edge)

    async def _set_positions(self, index: int) -> None:
        """Tell the board where the motors of a homed joint are, once all the joints that they carry are homed."""
        joints = _WRIST_JOINTS if index in _WRIST_JOINTS else (index,)
        if not all(self.homed[joint] for joint in joints):
            return
        # What the arm stands at is the count of steps made, not the fraction of a step that is due beyond it.
        # Play that is taken up stays in the motors' positions.
        counts_deg = self._arm.joints_from_motors(self._stream.positions_steps[:5])
        true_deg = [float(angle) + offset for angle, offset in zip(counts_deg, self._offset_deg, strict=True)]
        # For uncoupled joints motor and joint have the same index; the wrist's two motors carry its two joints.
        steps = self._arm.motors_from_joints(true_deg)
        await self._stream.set_positions({motor: round(float(steps[motor])) for motor in joints})
        for joint in joints:
            self._offset_deg[joint] = 0.0

    async def _go_home(self, index: int) -> None:
        home = self._config.joints.ordered[index].home
        start_deg = self._counter_deg()
        target_deg = list(start_deg)
        target_deg[index] = home.home_deg - self._offset_deg[index]
        pieces = plan_joint_move(self._arm, self._config, start_deg, target_deg, ignore_limits=True)
        if home.ignore_limits:
            await self._stream.play(pieces)
            return
        if await self._stream.play_until(pieces, InputId[home.input], Edge.RISING) is not None:
            self.homed[index] = False
            raise self._error(index, "the switch closed again on the way home", "again")

    def _counter_deg(self) -> list[float]:
        exact = [position / ONE_STEP for position in self._stream.positions_q48[:5]]
        angles = self._arm.joints_from_motors(exact)
        return [float(angle) - ahead for angle, ahead in zip(angles, self._stream.offsets.deg, strict=True)]

    def _released_deg(self, index: int, away: float) -> float:
        """The angle at the latched count: the first whole step past the switch, where it reads open.

        Counts are made whole when the motors are set, so this is the count nearest to the truth, without the bias of
        half a step that the switch angle itself would have.
        """
        motors = self._config.motors.ordered
        carriers = _WRIST_JOINTS if index in _WRIST_JOINTS else (index,)
        steps_per_deg = max(motors[motor].steps_per_deg for motor in carriers)
        flank_deg = self._flank_deg(index, away)
        switch_steps = (self._config.joints.ordered[index].home.switch_deg + flank_deg) * steps_per_deg
        return away * (math.floor(away * switch_steps + _SAME_STEP) + 1) / steps_per_deg - flank_deg

    def _active(self, index: int) -> bool:
        switch = InputId[self._config.joints.ordered[index].home.input]
        return bool(self._stream.inputs >> switch & 1)

    def _error(self, index: int, what: str, kind: str) -> HomingError:
        remedy = {
            "stuck": "free the switch or mend its wiring (it reads active), then home again",
            "open": "look for a cut wire, a switch out of place or a motor that did not turn, then home again",
            "again": "mend a loose contact, or set ignore_limits if the home position lies past it; then home again",
            "loose": "tighten the switch, look for bounce and play in the joint, then home again",
        }[kind]
        return HomingError(JOINT_NAMES[index], self._config.joints.ordered[index].home.input, what, remedy)
