"""The configuration as types: every key of the TOML file, with its unit in its name and its allowed range in its
type.

Where a number comes from stands in `configs/rm501.toml`. Checks that span several keys are in `checks.py`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct

Positive = Annotated[float, Meta(gt=0)]
NonNegative = Annotated[float, Meta(ge=0)]
PositiveInt = Annotated[int, Meta(gt=0)]
Vector3 = tuple[float, float, float]
Sign = Literal[-1, 1]

JOINT_NAMES = ("waist", "shoulder", "elbow", "pitch", "roll")
"""Joints 1..5 of the DH table, indices 0..4."""

MOTOR_NAMES = ("waist", "shoulder", "elbow", "right_wrist", "left_wrist")
"""The motors that segments move, indices 0..4; the hand (index 5) is driven by events."""


class _Section(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of the file: no key is optional unless it says so, no key is ignored."""


class MachineSection(_Section, frozen=True):
    """`[machine]`: what programs are written for."""

    name: str
    coordinates: Literal["XYZAB", "XYZABC"]
    orientation_tolerance_deg: NonNegative


class FrameSection(_Section, frozen=True):
    """`[frame]`: pose of the program frame in the base frame: R = Rz(yaw) Ry(pitch) Rx(roll)."""

    xyz_mm: Vector3
    rpy_deg: Vector3


class GeometrySection(_Section, frozen=True):
    """`[geometry]`: the DH lengths that are not zero."""

    d1_mm: NonNegative
    a2_mm: Positive
    a3_mm: Positive
    d5_mm: NonNegative


class ToolSection(_Section, frozen=True):
    """`[tool]`: tool centre point beyond d5: along the tool, across it (tool X, Y), and tilt (about tool X, then
    Y)."""

    length_mm: float
    offset_mm: tuple[float, float]
    tilt_deg: tuple[float, float]


class HomeSection(_Section, frozen=True):
    """`[joints.NAME.home]`: how the joint finds its switch (LinuxCNC's HOME_* terms)."""

    sequence: Annotated[int, Meta(ge=0)]
    input: str
    switch_deg: float
    active: Literal["below", "above"]
    search_deg_s: float
    latch_deg_s: float
    home_deg: float
    latch_spread_deg: Positive
    ignore_limits: bool


class JointSection(_Section, frozen=True):
    """`[joints.NAME]`: range and limits of a joint, DH angles."""

    min_deg: float
    max_deg: float
    max_velocity_deg_s: Positive
    max_acceleration_deg_s2: Positive
    max_jerk_deg_s3: Positive
    backlash_deg: NonNegative
    home: HomeSection


class JointsSection(_Section, frozen=True):
    """`[joints]`: the five joints."""

    waist: JointSection
    shoulder: JointSection
    elbow: JointSection
    pitch: JointSection
    roll: JointSection

    @property
    def ordered(self) -> tuple[JointSection, JointSection, JointSection, JointSection, JointSection]:
        """Joints 1..5 in DH order."""
        return (self.waist, self.shoulder, self.elbow, self.pitch, self.roll)


class MotorSection(_Section, frozen=True):
    """`[motors.NAME]`: a step generator; the limits hold in planning, `board` derives those that the board
    enforces.

    `backlash_deg`: play of a wrist motor's gear train, in deg of the motor as its steps count; that of the other motors
    is the joint's."""

    steps_per_deg: Positive
    max_rate_steps_s: Positive
    max_acceleration_deg_s2: Positive
    backlash_deg: NonNegative = 0.0


class MotorsSection(_Section, frozen=True):
    """`[motors]`: the five arm motors."""

    waist: MotorSection
    shoulder: MotorSection
    elbow: MotorSection
    right_wrist: MotorSection
    left_wrist: MotorSection

    @property
    def ordered(self) -> tuple[MotorSection, MotorSection, MotorSection, MotorSection, MotorSection]:
        """Motors 0..4 in step generator order."""
        return (self.waist, self.shoulder, self.elbow, self.right_wrist, self.left_wrist)


class DriveSection(_Section, frozen=True):
    """`[drive]`: joint to motor, DH deg to motor deg: signs of the first three, rows (right, left) on (pitch,
    roll)."""

    signs: tuple[Sign, Sign, Sign]
    wrist_matrix: tuple[tuple[float, float], tuple[float, float]]


class HandSection(_Section, frozen=True):
    """`[hand]`: the two-finger hand, driven by power pulses on real frames."""

    stroke_pulses: PositiveInt
    pulse_rate_steps_s: Positive
    settle_s: NonNegative


class StepSection(_Section, frozen=True):
    """`[board.step]`: pulse rules, counted in frames at the latch."""

    length_frames: PositiveInt
    space_frames: PositiveInt
    dir_setup_frames: PositiveInt
    dir_hold_frames: PositiveInt


class WiringSection(_Section, frozen=True):
    """`[board.wiring]`: what pin table and .hal disagree about, and which optional lines are fitted."""

    swap_wrist_selects: bool
    swap_wrist_switches: bool
    outputs_active_low: bool
    motor_power: bool
    heartbeat: bool
    estop: bool
    buttons: bool


class BoardSection(_Section, frozen=True, kw_only=True):
    """`[board]`: the scan, the pulse rules, the wiring and the watchdogs of the microcontroller."""

    base_period_us: PositiveInt
    table: tuple[int, ...]
    debounce_frames: PositiveInt
    link_timeout_ms: Annotated[int, Meta(gt=0, le=65_535)]
    idle_power_off_ms: Annotated[int, Meta(ge=0, le=65_535)] = 0
    """Silence at rest that switches motor power off; 0: never."""
    jog_lease_ms: PositiveInt
    limit_margin: Annotated[float, Meta(ge=1.0, le=1.2)]
    digital_outputs: Annotated[tuple[Annotated[str, Meta(pattern=r"^[01]\.\d{1,2}$")], ...], Meta(max_length=8)]
    step: StepSection
    wiring: WiringSection


class LinkSection(_Section, frozen=True):
    """`[link]`: how the board is reached when `--port` is not given."""

    port: str
    baud: PositiveInt


class PlannerSection(_Section, frozen=True):
    """`[planner]`: what the time law may use.

    `blend`: how G64 rounds corners between Cartesian moves: by circles, or by parabolas (which bend more in the middle
    and less at their ends). With `jerk_limited` blends are quintics, whatever it says. `backlash_acceleration_share`:
    of a joint's acceleration, for taking up its play where `backlash_deg` is not 0.
    """

    tolerance_steps: Positive
    hold_acceleration_ratio: Annotated[float, Meta(gt=1)]
    stop_acceleration_ratio: Annotated[float, Meta(gt=1)]
    stall_budget_s: NonNegative
    jerk_limited: bool
    linear_rapids: bool
    backlash_acceleration_share: Annotated[float, Meta(gt=0, le=0.5)] = 0.1
    blend: Literal["circular", "parabolic"] = "circular"
    tcp_max_speed_mm_s: Positive | None = None
    tcp_max_acceleration_mm_s2: Positive | None = None


class BoxSection(_Section, frozen=True):
    """`[[keep_out.boxes]]`: an axis-parallel box in the base frame that links and hand must not enter."""

    name: str
    min_mm: Vector3
    max_mm: Vector3


class KeepOutSection(_Section, frozen=True):
    """`[keep_out]`: where the arm must not be; the table plane is z = `table_z_mm` in the base frame.

    The arm is checked with its thickness: capsules of these radii around upper arm, forearm and hand.
    """

    upper_arm_radius_mm: Positive
    forearm_radius_mm: Positive
    hand_radius_mm: Positive
    table_z_mm: float | None = None
    boxes: tuple[BoxSection, ...] = ()


class GcodeSection(_Section, frozen=True):
    """`[gcode]`: what programs may call beyond motion.

    `m_codes_folder`: executables M103 to M199, called with P and Q, relative to where the host was started. `outputs`:
    what M3, M4, M5, M7, M8, M9 do, as [output, on]; a code that is not listed is refused (M5, M9: does nothing).
    """

    m_codes_timeout_s: Positive
    m_codes_folder: str | None = None
    outputs: dict[Literal["M3", "M4", "M5", "M7", "M8", "M9"], tuple[Annotated[int, Meta(ge=0, le=7)], bool]] = {}


class PreflightSection(_Section, frozen=True):
    """`[preflight]`: how far a program is checked before it starts; from there it is checked ahead of the motion."""

    max_blocks: PositiveInt


class Config(_Section, frozen=True):
    """The whole configuration; made by `load_config`, which also checks what spans several keys."""

    machine: MachineSection
    frame: FrameSection
    geometry: GeometrySection
    tool: ToolSection
    joints: JointsSection
    motors: MotorsSection
    drive: DriveSection
    hand: HandSection
    board: BoardSection
    link: LinkSection
    planner: PlannerSection
    keep_out: KeepOutSection
    gcode: GcodeSection
    preflight: PreflightSection

    @property
    def home_deg(self) -> tuple[float, ...]:
        """The home position, joints 1..5 in deg."""
        return tuple(joint.home.home_deg for joint in self.joints.ordered)
