"""How faults are written: `NAME[:KEY=VALUE,...][@WHEN][/DURATION]`.

    flip:p=1e-4                         from the start, for ever
    stall:motor=elbow@2.5s              2.5 s after power-up
    lost-steps:motor=waist,n=40@waist>-20   when the waist passes -20 deg upwards
    unplug@10s/0.5s                     for half a second
    burst:ms=50@0.2/s                   at random, 0.2 times a second on average

WHEN is a time (`2.5s`), a true joint angle to be passed (`elbow<-45`) or a mean rate (`0.2/s`). DURATION ends the fault
again where it can end.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from rm501_sim_board.errors import FaultSpecError
from rm501_sim_board.geometry import Joint

_TIME = re.compile(r"([0-9.eE+-]+)s")
_RATE = re.compile(r"([0-9.eE+-]+)/s")
_PLACE = re.compile(r"([a-z]+)([<>])(-?[0-9.]+)(?:deg)?")
_NAME = re.compile(r"[a-z][a-z-]*")


@dataclass(frozen=True, slots=True)
class AtTime:
    """So many seconds after power-up."""

    seconds: float


@dataclass(frozen=True, slots=True)
class AtAngle:
    """When a joint passes an angle, upwards or downwards."""

    joint: Joint
    upwards: bool
    angle_deg: float


@dataclass(frozen=True, slots=True)
class AtRandom:
    """Again and again, at random, with a mean number of times per second."""

    per_second: float


When = AtTime | AtAngle | AtRandom


@dataclass(frozen=True, slots=True)
class FaultSpec:
    """One fault to inject: what, with which parameters (as written), when, and for how long."""

    name: str
    parameters: dict[str, str] = field(default_factory=dict)
    when: When = AtTime(0.0)
    duration_s: float | None = None


def parse_fault(text: str) -> FaultSpec:
    """Understand a fault specification; FaultSpecError tells what is wrong with which part of it."""
    rest, duration_s = text, None
    if (slash := rest.rfind("/")) >= 0 and not rest.endswith("/s"):
        duration_s = _seconds(text, rest[slash + 1 :], "duration")
        rest = rest[:slash]
    rest, at, when_text = rest.partition("@")
    when = _when(text, when_text) if at else AtTime(0.0)
    name, colon, parameter_text = rest.partition(":")
    if not _NAME.fullmatch(name):
        raise FaultSpecError(f"fault {text!r}: {name!r} is no name; see --list-faults")
    parameters: dict[str, str] = {}
    for item in parameter_text.split(",") if colon else ():
        key, equals, value = item.partition("=")
        if not equals or not key or not value:
            raise FaultSpecError(f"fault {text!r}: {item!r} is not KEY=VALUE")
        parameters[key] = value
    return FaultSpec(name, parameters, when, duration_s)


def _when(text: str, when: str) -> When:
    if match := _RATE.fullmatch(when):
        rate = _number(text, match[1])
        if rate <= 0.0:
            raise FaultSpecError(f"fault {text!r}: a rate of {rate}/s never happens; give a positive one")
        return AtRandom(rate)
    if match := _PLACE.fullmatch(when):
        try:
            joint = Joint[match[1].upper()]
        except KeyError:
            names = ", ".join(j.name.lower() for j in Joint)
            raise FaultSpecError(f"fault {text!r}: {match[1]!r} is no joint; use {names}") from None
        return AtAngle(joint, match[2] == ">", _number(text, match[3]))
    return AtTime(_seconds(text, when, "time"))


def _seconds(text: str, value: str, what: str) -> float:
    match = _TIME.fullmatch(value)
    seconds = _number(text, match[1]) if match else -1.0
    if seconds < 0.0:
        raise FaultSpecError(
            f"fault {text!r}: {what} {value!r} is not like 2.5s" + (", elbow<-45 or 0.2/s" if what == "time" else "")
        )
    return seconds


def _number(text: str, value: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise FaultSpecError(f"fault {text!r}: {value!r} is not a number") from None
