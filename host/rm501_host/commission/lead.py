"""The way through a new arm: press each switch, see one joint at a time turn, say what was seen.

Every step moves one joint by `STEP_DEG` and back, never more: a step that was broken off ends the whole way.
"""

from __future__ import annotations

import asyncio
from typing import Any

from rm501_host.client.client import DaemonClient
from rm501_host.commission.derive import CommissionError, Seen, drive_signs, switches_swapped, wrist_matrix
from rm501_host.commission.terminal import Terminal
from rm501_host.config import JOINT_NAMES, Config
from rm501_host.errors import StoppedError

STEP_DEG = 5.0
STEP_SPEED_DEG_S = 3.0
_POSITIVE = {
    "waist": "counter-clockwise, seen from above",
    "shoulder": "up",
    "elbow": "up (the forearm toward straight)",
}
_SELECTS = {
    "waist": "ELBOW SELECT (0.5) and WAIST SELECT (0.6) of board 724",
    "shoulder": "SHOULDER SELECT (1.4) and both wrist selects (1.5, 1.6) of board 732",
    "elbow": "ELBOW SELECT (0.5) and WAIST SELECT (0.6) of board 724",
}
_SEEN = {
    "hand-up": Seen.PITCH_PLUS,
    "hand-down": Seen.PITCH_MINUS,
    "turned-right": Seen.ROLL_PLUS,
    "turned-left": Seen.ROLL_MINUS,
}
_WATCH_S = 60.0
_PAUSE_S = 0.5


async def lead(client: DaemonClient, config: Config, terminal: Terminal) -> dict[str, Any]:
    """What the configuration has to change, as nested tables; raises CommissionError, StoppedError, RemoteError."""
    await client.subscribe(20)
    inputs = [joint.home.input for joint in config.joints.ordered]
    seen = {}
    for name, switch in zip(JOINT_NAMES, inputs, strict=True):
        seen[switch] = await _watch(client, terminal, name, switch, inputs)
    swap = switches_swapped(seen, config.board.wiring.swap_wrist_switches)
    if (await client.call("status"))["task_state"] != "ON":
        await client.call("reset")
    right = [await _turned_right(client, terminal, name) for name in JOINT_NAMES[:3]]
    wrist = [await _saw(client, terminal, name) for name in JOINT_NAMES[3:]]
    matrix = wrist_matrix(config.drive.wrist_matrix, wrist[0], wrist[1])
    return {
        "drive": {"signs": list(drive_signs(config.drive.signs, right)), "wrist_matrix": [list(row) for row in matrix]},
        "board": {"wiring": {"swap_wrist_switches": swap}},
    }


async def _watch(client: DaemonClient, terminal: Terminal, name: str, switch: str, inputs: list[str]) -> str:
    """Wait until a person has pressed a joint's switch; the input that became active."""
    before = set(client.status["inputs"]) & set(inputs)
    if before:
        raise CommissionError(
            f"{', '.join(sorted(before))} is active before anybody pressed it: move that joint off its switch by hand "
            "with the motors off, or look at its wiring; then begin again"
        )
    terminal.say(f"Press the switch of the {name} by hand and hold it ...")
    try:
        await client.status_where(lambda now: bool(set(now["inputs"]) & set(inputs)), _WATCH_S)
    except TimeoutError:
        raise StoppedError(f"no switch closed within {_WATCH_S:.0f} s; look at {switch} and its wiring") from None
    closed: list[str] = sorted(set(client.status["inputs"]) & set(inputs))
    if len(closed) > 1:
        raise CommissionError(f"{' and '.join(closed)} closed together; look for a short, then begin again")
    terminal.say(f"  {closed[0]}. Let go.")
    try:
        await client.status_where(lambda now: closed[0] not in now["inputs"], _WATCH_S)
    except TimeoutError:
        raise StoppedError(f"{closed[0]} did not open within {_WATCH_S:.0f} s; look at the switch") from None
    return closed[0]


async def _step(client: DaemonClient, terminal: Terminal, joint: str) -> None:
    await terminal.wait(f"The {joint} turns by {STEP_DEG:.0f} deg and back; look at it.")
    for way in (1, -1):
        await client.motion("jog.start", frame="joint", axis=joint, speed=way * STEP_SPEED_DEG_S, distance=STEP_DEG)
        await asyncio.sleep(_PAUSE_S)


async def _turned_right(client: DaemonClient, terminal: Terminal, joint: str) -> bool:
    await _step(client, terminal, joint)
    answer = await terminal.ask(
        f"The {joint} was commanded {_POSITIVE[joint]}, then back. What turned?",
        ("right", "wrong-way", "another-joint", "nothing"),
    )
    if answer == "another-joint":
        raise CommissionError(
            f"another joint than the {joint} turned: {_SELECTS[joint]} are mixed up; correct the wiring, begin again"
        )
    if answer == "nothing":
        raise CommissionError(
            f"the {joint} did not turn: look at the power of the drives, STROBE, and {_SELECTS[joint]}; begin again"
        )
    return answer == "right"


async def _saw(client: DaemonClient, terminal: Terminal, joint: str) -> Seen:
    await _step(client, terminal, joint)
    answer = await terminal.ask(
        f"What did the hand do first on {joint}+ (turns are seen along the hand, from the arm)?",
        (*_SEEN, "nothing", "another-joint"),
    )
    if answer not in _SEEN:
        raise CommissionError(
            "the wrist did not turn: look at the power of the drives, STROBE, SHOULDER SELECT (1.4) and both wrist "
            "selects (1.5, 1.6) of board 732; begin again"
        )
    return _SEEN[answer]
