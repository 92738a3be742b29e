"""From a LinuxCNC INI to our configuration, value by value.

An INI knows joint limits, homing, scales and step timing. Geometry, pins and the wrist matrix live in LinuxCNC's
HAL and kinematics files; they come from the base configuration and the report says so. Signs: the RM-501's INI counts
joints 2, 3, 4 against the DH angles used here (`joint_signs`), so their limits swap and change sign, their switches
and speeds change sign, and so does the drive's sign; the motors turn as before.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from rm501_host.config.schema import JOINT_NAMES, MOTOR_NAMES
from rm501_host.ini_import.reader import IniError, IniFile, IniValue

RM501_JOINT_SIGNS = (1, -1, -1, -1, 1)
"""DH angle = sign x INI angle, for the thesis's INI (its joints 2, 3, 4 count the other way)."""
_SINGLE_JOINTS = 3
_YES = {"YES": True, "TRUE": True, "1": True, "NO": False, "FALSE": False, "0": False}
_MM_PER = {"MM": 1.0, "METRIC": 1.0, "INCH": 25.4, "IN": 25.4, "IMPERIAL": 25.4, "CM": 10.0}
_DEG_PER = {"DEG": 1.0, "DEGREE": 1.0, "DEGREES": 1.0, "RAD": 180.0 / math.pi, "GRAD": 0.9}


class Outcome(Enum):
    """What became of a value."""

    TAKEN = "taken"
    CONVERTED = "converted"
    IGNORED = "ignored"
    KEPT = "kept"
    """Not in the INI: the base configuration's value stands."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The fate of one value: where it stood, what became of it, and why."""

    line: int | None
    place: str
    text: str
    outcome: Outcome
    key: str
    note: str

    def __str__(self) -> str:
        where = "" if self.line is None else f"line {self.line}: "
        target = f" -> {self.key}" if self.key else ""
        note = f" ({self.note})" if self.note else ""
        return f"{self.outcome.value:9} {where}{self.place} = {self.text}{target}{note}"


@dataclass(frozen=True, slots=True)
class Conversion:
    """The new configuration as nested tables, the origin of its values, and the whole account."""

    data: dict[str, Any]
    origins: dict[str, str]
    findings: tuple[Finding, ...]


def convert_ini(ini: IniFile, base: Mapping[str, Any], joint_signs: tuple[int, ...] = RM501_JOINT_SIGNS) -> Conversion:
    """Lay the INI's values over a copy of `base`. Every value of the INI appears in `findings` exactly once.

    Raises IniError for values that cannot be understood or that describe another kind of machine.
    """
    return _Converter(ini, base, joint_signs).convert()


class _Converter:
    def __init__(self, ini: IniFile, base: Mapping[str, Any], joint_signs: tuple[int, ...]) -> None:
        if len(joint_signs) != len(JOINT_NAMES) or any(sign not in (-1, 1) for sign in joint_signs):
            raise IniError(ini.name, None, f"joint signs {joint_signs}", "give five of 1 and -1")
        self._ini = ini
        self._signs = joint_signs
        self._data: dict[str, Any] = copy.deepcopy(dict(base))
        self._origins: dict[str, str] = {}
        self._findings: dict[int, Finding] = {}
        self._kept: list[Finding] = []

    def convert(self) -> Conversion:
        self._machine()
        self._trajectory()
        for index, name in enumerate(JOINT_NAMES):
            section = self._joint_section(index)
            self._joint(index, name, section)
            self._motor(index, MOTOR_NAMES[index], section)
        self._rest()
        for key, why in (
            ("geometry", "link lengths are in LinuxCNC's kinematics module"),
            ("drive.wrist_matrix", "it is wired in the HAL file"),
            ("board.wiring", "pins are in the HAL file"),
            ("board.table", "the select/strobe table is in the HAL file"),
        ):
            self._kept.append(Finding(None, f"[{key}]", "base configuration", Outcome.KEPT, key, why))
        ordered = tuple(self._findings[line] for line in sorted(self._findings))
        return Conversion(self._data, self._origins, (*ordered, *self._kept))

    # ---------------------------------------------------------------- sections

    def _machine(self) -> None:
        if value := self._ini.get("EMC", "MACHINE"):
            self._set("machine.name", value.text, value)
        joints = self._ini.get("KINS", "JOINTS")
        if joints is not None:
            if self._number(joints) != len(JOINT_NAMES):
                raise self._wrong(joints, "this arm has five joints", "import the INI of a five-joint arm")
            self._note(joints, Outcome.TAKEN, "", "checked: five joints")
        if value := self._ini.get("EMCMOT", "BASE_PERIOD"):
            period_us = self._number(value) / 1000.0
            if period_us != int(period_us) or period_us <= 0:
                raise self._wrong(value, "is not a whole number of us", "give the base period in ns, such as 40000")
            self._set("board.base_period_us", int(period_us), value, "ns to us")

    def _trajectory(self) -> None:
        if value := self._ini.get("TRAJ", "COORDINATES"):
            letters = "".join(value.text.split()).upper()
            coordinates = {"XYZAB": "XYZAB", "XYZABC": "XYZABC"}.get(letters)
            if coordinates is None:
                raise self._wrong(value, "is not a coordinate system of this host", "use XYZAB or XYZABC")
            self._set("machine.coordinates", coordinates, value)
        per_mm, _ = self._unit("LINEAR_UNITS", _MM_PER, 1.0)
        for key, target in (
            ("MAX_LINEAR_VELOCITY", "tcp_max_speed_mm_s"),
            ("MAX_LINEAR_ACCELERATION", "tcp_max_acceleration_mm_s2"),
        ):
            value = self._ini.get("TRAJ", key)
            if value is None:
                continue
            if not value.text:
                self._note(value, Outcome.IGNORED, "", "has no value: no limit is set")
                continue
            self._set(f"planner.{target}", self._positive(value) * per_mm, value, "" if per_mm == 1.0 else "to mm")

    def _joint_section(self, index: int) -> str:
        """[JOINT_N], or [AXIS_N] of the releases before joints and axes were told apart."""
        present = self._ini.sections()
        for section in (f"JOINT_{index}", f"AXIS_{index}"):
            if section in present:
                return section
        raise IniError(self._ini.name, None, f"there is no [JOINT_{index}]", "give the INI of a five-joint arm")

    def _joint(self, index: int, name: str, section: str) -> None:
        sign = self._signs[index]
        per_deg, _ = self._unit("ANGULAR_UNITS", _DEG_PER, 1.0)
        flipped = "sign changed: DH angle" if sign < 0 else ""
        key = f"joints.{name}"
        if (kind := self._ini.get(section, "TYPE")) is not None:
            if kind.text.upper() != "ANGULAR":
                raise self._wrong(kind, "is not ANGULAR", "every joint of this arm turns")
            self._note(kind, Outcome.TAKEN, "", "checked: ANGULAR")
        low, high = self._ini.get(section, "MIN_LIMIT"), self._ini.get(section, "MAX_LIMIT")
        if sign < 0:
            low, high = high, low
        for source, target in ((low, "min_deg"), (high, "max_deg")):
            if source is not None:
                note = "limits swapped, sign changed: DH angle" if sign < 0 else ""
                self._set(f"{key}.{target}", _plus(sign * self._number(source) * per_deg), source, note)
        for ini_key, target in (
            ("MAX_ACCELERATION", "max_acceleration_deg_s2"),
            ("BACKLASH", "backlash_deg"),
        ):
            if value := self._ini.get(section, ini_key):
                self._set(f"{key}.{target}", abs(self._number(value)) * per_deg, value)
        for ini_key, target in (
            ("HOME", "home_deg"),
            ("HOME_OFFSET", "switch_deg"),
            ("HOME_SEARCH_VEL", "search_deg_s"),
            ("HOME_LATCH_VEL", "latch_deg_s"),
        ):
            if value := self._ini.get(section, ini_key):
                self._set(f"{key}.home.{target}", _plus(sign * self._number(value) * per_deg), value, flipped)
        search = self._data["joints"][name]["home"]["search_deg_s"]
        self._derive(f"{key}.home.active", "below" if search < 0 else "above", "the side that HOME_SEARCH_VEL leads to")
        if value := self._ini.get(section, "HOME_SEQUENCE"):
            self._set(f"{key}.home.sequence", int(self._number(value)), value)
        if value := self._ini.get(section, "HOME_IGNORE_LIMITS"):
            self._set(f"{key}.home.ignore_limits", self._yes(value), value)
        for ini_key in ("HOME_USE_INDEX", "HOME_IS_SHARED"):
            value = self._ini.get(section, ini_key)
            if value is not None:
                if self._yes(value):
                    raise self._wrong(value, "is not supported", "home on a switch of the joint's own, without index")
                self._note(value, Outcome.TAKEN, "", "checked: NO")

    def _motor(self, index: int, name: str, section: str) -> None:
        key = f"motors.{name}"
        per_deg, _ = self._unit("ANGULAR_UNITS", _DEG_PER, 1.0)
        scale = self._ini.get(section, "SCALE")
        steps_per_deg = self._data["motors"][name]["steps_per_deg"]
        if scale is not None:
            steps_per_unit = self._number(scale)
            if steps_per_unit == 0:
                raise self._wrong(scale, "is zero", "give steps per degree")
            steps_per_deg = abs(steps_per_unit) / per_deg
            self._set(f"{key}.steps_per_deg", steps_per_deg, scale)
            if index < _SINGLE_JOINTS:
                signs = list(self._data["drive"]["signs"])
                signs[index] = self._signs[index] * (1 if steps_per_unit > 0 else -1)
                self._data["drive"]["signs"] = signs
                self._origins["drive.signs"] = "signs of SCALE and of the joints' DH angles"
            elif steps_per_unit < 0:
                raise self._wrong(scale, "is negative on a wrist motor", "put its sign into drive.wrist_matrix")
        rate_steps_s, why = self._rate(section, steps_per_deg, per_deg)
        velocity = self._ini.get(section, "STEPGEN_MAXVEL")
        if velocity is not None:
            self._set(f"{key}.max_rate_steps_s", rate_steps_s, velocity, why)
        else:
            self._derive(f"{key}.max_rate_steps_s", rate_steps_s, why)
        if value := self._ini.get(section, "STEPGEN_MAXACCEL"):
            self._set(f"{key}.max_acceleration_deg_s2", self._positive(value) * per_deg, value)
        if value := self._ini.get(section, "MAX_VELOCITY"):
            wanted = self._positive(value) * per_deg
            reachable = rate_steps_s / steps_per_deg
            joint = f"joints.{JOINT_NAMES[index]}.max_velocity_deg_s"
            if wanted > reachable:
                # Tenths below what the motor steps; the small term keeps 45 from becoming 44.9.
                capped = math.floor(10 * reachable + 1e-6) / 10
                self._set(joint, capped, value, f"the motor reaches {reachable:.1f} deg/s")
            else:
                self._set(joint, wanted, value)

    def _rate(self, section: str, steps_per_deg: float, per_deg: float) -> tuple[float, str]:
        """Largest step rate: STEPGEN_MAXVEL, and what the step timing leaves of it after rounding to base periods."""
        base_ns = self._data["board"]["base_period_us"] * 1000
        periods = 0
        for key in ("STEP_LENGTH", "STEP_SPACE", "DIR_HOLD", "DIR_SETUP"):
            value = self._ini.get(section, key)
            if value is None:
                continue
            if key.startswith("STEP_"):
                periods += math.ceil(self._positive(value) / base_ns)
                note = "limits the step rate; the board counts frames at the latch, one is enough"
            else:
                note = "one frame at the latch, which is longer"
            self._note(value, Outcome.CONVERTED, f"board.step.{key.lower()}_frames", note)
        from_timing = 1e9 / (periods * base_ns) if periods else math.inf
        velocity = self._ini.get(section, "STEPGEN_MAXVEL")
        from_velocity = self._positive(velocity) * per_deg * steps_per_deg if velocity is not None else math.inf
        if math.isinf(min(from_timing, from_velocity)):
            raise IniError(
                self._ini.name, None, f"[{section}] has neither STEPGEN_MAXVEL nor STEP_LENGTH", "add one of them"
            )
        if from_timing <= from_velocity:
            return from_timing, f"STEP_LENGTH and STEP_SPACE allow {from_timing:.0f} steps/s"
        return from_velocity, "deg/s to steps/s"

    def _rest(self) -> None:
        for value in self._ini.values:
            if value.line not in self._findings:
                self._note(value, Outcome.IGNORED, "", _why_ignored(value))

    # ---------------------------------------------------------------- values

    def _unit(self, key: str, table: Mapping[str, float], default: float) -> tuple[float, IniValue | None]:
        value = self._ini.get("TRAJ", key)
        if value is None:
            return default, None
        factor = table.get(value.text.upper())
        if factor is None:
            try:
                factor = 1.0 / self._positive(value)
            except IniError:
                raise self._wrong(value, "is no unit", f"use one of {', '.join(table)}") from None
        self._note(value, Outcome.TAKEN, "", "every length or angle is converted with it")
        return factor, value

    def _number(self, value: IniValue) -> float:
        try:
            number = float(value.text)
        except ValueError:
            raise self._wrong(value, f"{value.text!r} is not a number", "correct it in the INI file") from None
        if not math.isfinite(number):
            raise self._wrong(value, f"{value.text!r} is not finite", "correct it in the INI file")
        return number

    def _positive(self, value: IniValue) -> float:
        number = self._number(value)
        if number <= 0:
            raise self._wrong(value, f"{value.text} is not above 0", "correct it in the INI file")
        return number

    def _yes(self, value: IniValue) -> bool:
        try:
            return _YES[value.text.upper()]
        except KeyError:
            raise self._wrong(value, f"{value.text!r} is neither YES nor NO", "write YES or NO") from None

    def _wrong(self, value: IniValue, message: str, remedy: str) -> IniError:
        return IniError(self._ini.name, value.line, f"[{value.section}]{value.key}: {message}", remedy)

    def _set(self, key: str, new: object, source: IniValue, note: str = "") -> None:
        self._put(key, new)
        self._origins[key] = f"{self._ini.name}:{source.line}" + (f", {note}" if note else "")
        self._note(source, Outcome.CONVERTED if note else Outcome.TAKEN, key, note)

    def _derive(self, key: str, new: object, note: str) -> None:
        self._put(key, new)
        self._origins[key] = note

    def _put(self, key: str, new: object) -> None:
        *path, last = key.split(".")
        table = self._data
        for part in path:
            table = table[part]
        table[last] = new

    def _note(self, value: IniValue, outcome: Outcome, key: str, note: str) -> None:
        place = f"[{value.section}]{value.key}"
        self._findings[value.line] = Finding(value.line, place, value.text, outcome, key, note)


_REASONS: Mapping[str, Callable[[IniValue], str]] = {
    "DISPLAY": lambda _: "the display is not part of this configuration",
    "EMCMOT": lambda value: (
        "the board has one frame; servo and trajectory periods do not exist"
        if value.key.endswith("PERIOD")
        else "belongs to LinuxCNC's motion module"
    ),
    "HAL": lambda _: "there is no HAL here: pins and mux are board.table and board.wiring",
    "TRAJ": lambda value: (
        "programs and the planner say how fast; the limits are taken"
        if value.key.startswith("DEFAULT_")
        else "follows from the joints"
    ),
}


def _why_ignored(value: IniValue) -> str:
    if value.key in ("FERROR", "MIN_FERROR"):
        return "the board has no encoders: OVERFLOW lines and `verify` find lost steps"
    if value.section.startswith("AXIS_"):
        return "joint limits copied into Cartesian axes; the joints' own limits hold"
    if value.section.startswith("JOINT_"):
        return "a repeated key: the first one counts, or one without a meaning here"
    reason = _REASONS.get(value.section)
    return reason(value) if reason is not None else "belongs to LinuxCNC itself"


def _plus(number: float) -> float:
    """Turn -0.0 into 0.0."""
    return number + 0.0
