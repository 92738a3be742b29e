"""Every row of the fault catalogue, end to end: the real host homes and runs a program while things go wrong.

    python -m benchmarks.faults [--rows 1,13,28] [--n SEEDS]

A case passes when the run ends as the catalogue demands: either the same steps as without the fault, or a stop that
says why, after which nothing moves any more. `host` marks rows whose fault lies in the host alone (API clients,
disks); they are tested with the host.
"""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks import fault_scenarios as scenarios
from benchmarks.fault_scenarios import Scenario
from rm501_host.config import load_config
from rm501_host.config.board import board_config_from
from rm501_host.errors import Rm501Error
from rm501_host.motion import Progress
from rm501_host.program_run import RunOptions, run_program
from rm501_host.session import open_session
from rm501_host.virtual_time import run_virtual
from rm501_protocol.enums import BoardState
from rm501_sim_board.bench import Truth
from rm501_sim_board.emu_transport import open_transport, running_board, shut_down

CONFIG = Path(__file__).parents[1] / "configs" / "thesis.toml"
# Near its switches, so that homing takes 26 s and not a minute.
POSE = "-140,95,-82,8,-60"
PROGRAM_TEXT = """G21 G90 G94 G40 G49
G64 P0.5
G0 X290 Y0 Z-30 A0 B0 C0
G1 X290 Y0 Z30 F2800
M102
G1 X290 Y0 Z-30
M101
G1 X320 Y0 Z-30
M2
"""
# More segments than the queue has slots, in less time than they take: a host that believes in more slots uses them.
_THERE_AND_BACK = "".join(f"G1 X290 Y{y} Z-30 F1000\n" for y in (10, 0, -10, 0))
LONG_TEXT = f"G21 G90 G94 G40 G49\nG61\nG0 X290 Y0 Z-30 A0 B0 C0\n{6 * _THERE_AND_BACK}M2\n"
# The program runs from 26.5 s to 36.5 s after power-up; at 28 s all arm joints move.
AFTERWARDS_S = 8.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run under a fault ended, and what the world looked like a while later."""

    result: str
    text: str
    steps: str
    retransmits: int
    bad_frames: int
    state: BoardState
    truth: Truth
    trusted_mask: int
    late_steps: int
    fault_frame: int | None
    last_step_frame: int
    hand_pulses: int
    refused: int
    real_frame: int
    motion_frame: int


Check = Callable[[Outcome, Outcome], str]


@dataclass(frozen=True, slots=True)
class Case:
    """One fault as written, the row it belongs to, what is demanded in words, and the check (returns a complaint)."""

    row: int
    fault: str
    demand: str
    check: Check
    in_short: bool = False
    program: str = PROGRAM_TEXT


@dataclass(frozen=True, slots=True)
class Acted:
    """A row that takes a host doing something particular; `scenario` returns a complaint."""

    row: int
    name: str
    demand: str
    scenario: Scenario
    in_short: bool = False


class _Silent:
    def phase(self, name: str) -> None:
        """Nobody watches."""

    def progress(self, progress: Progress) -> None:
        """Nobody watches."""

    def message(self, text: str) -> None:
        """Nobody watches."""


async def _ask_board(options: RunOptions) -> tuple[BoardState, int, int, int]:
    """State, trust, refusals and motion frame as the board tells them to a new session; the mask is -1 when it refuses
    to talk.
    """
    try:
        config = board_config_from(load_config(CONFIG))
        session = await open_session(open_transport("emu://bench"), config, options.nonce)
    except (Rm501Error, OSError):
        return running_board("bench").emulator.board.state, -1, 0, 0
    status = await session.refresh_status()
    await session.aclose()
    return status.state, status.trusted_mask, status.refused, status.motion_frame


async def _outcome(fault: str, seed: int, program: Path) -> Outcome:
    nonces = random.Random(seed)
    url = f"emu://bench?pose={POSE}&seed={seed}" + (f"&fault={fault}" if fault else "")
    options = RunOptions(url, True, lambda: nonces.getrandbits(32))
    result, text, retransmits = "refused", "", 0
    try:
        done = await run_program(program, load_config(CONFIG), options, _Silent())
        result, text = done.report.result, "" if done.error is None else str(done.error)
        retransmits = done.report.wire.retransmits
    except (Rm501Error, OSError) as error:
        text = str(error)
    running = running_board("bench")
    running.board.run_to_now()
    emulator = running.emulator
    # A lost link is noticed after 1 s, the ramp takes up to 1.7 s: over by then; from here on nothing may move.
    await asyncio.sleep(AFTERWARDS_S / 2)
    settled = running.truth().commanded_steps
    await asyncio.sleep(AFTERWARDS_S / 2)
    truth = running.truth()
    recording = emulator.recording
    struck = [event.frame for event in running.faults.log if event.began]
    frames = [recording.step_frames(motor)[0] for motor in range(5)]
    board = emulator.board
    state, trusted_mask, refused, motion_frame = await _ask_board(options)
    outcome = Outcome(
        result=result,
        text=text,
        steps=recording.step_sequence_hash(),
        retransmits=retransmits,
        bad_frames=board.link.stats.bad_frames + board.link.stats.bad_packets,
        state=state,
        truth=truth,
        trusted_mask=trusted_mask,
        late_steps=sum(abs(a - b) for a, b in zip(truth.commanded_steps, settled, strict=True)),
        fault_frame=struck[0] if struck else None,
        last_step_frame=max((int(f[-1]) for f in frames if len(f)), default=0),
        hand_pulses=emulator.bench.hand.pulses_open + emulator.bench.hand.pulses_closed,
        refused=refused,
        real_frame=emulator.board.frame,
        motion_frame=motion_frame,
    )
    shut_down("bench")
    return outcome


def run_case(fault: str, seed: int = 1, text: str = PROGRAM_TEXT) -> Outcome:
    """Home and run a program with a fault (empty: none), on virtual time."""
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "short.ngc"
        program.write_text(text)
        return run_virtual(_outcome(fault, seed, program))


# ------------------------------------------------------------ what is demanded


def _same(outcome: Outcome, clean: Outcome) -> str:
    """The run ends well and makes exactly the steps of the undisturbed run."""
    if outcome.result != "ok":
        return f"{outcome.result}: {outcome.text}"
    return "" if outcome.steps == clean.steps else "other steps than the undisturbed run"


def _noticed(outcome: Outcome, clean: Outcome) -> str:
    """As `_same`, and the damage was seen."""
    if not outcome.bad_frames and not outcome.retransmits:
        return "no damage was noticed: the fault did nothing"
    return _same(outcome, clean)


def _stopped(*words: str, untrusted: int = 0, state: BoardState | None = None) -> Check:
    """The run ends with an error that has all `words`, nothing moves afterwards, `untrusted` motors are not trusted."""

    def check(outcome: Outcome, clean: Outcome) -> str:
        if outcome.result == "ok":
            return "the run ended as if nothing had happened"
        missing = [word for word in words if word.lower() not in outcome.text.lower()]
        if missing:
            return f"the message does not say {', '.join(missing)}: {outcome.text}"
        if outcome.late_steps:
            return f"{outcome.late_steps} steps were made long after the end"
        if outcome.trusted_mask >= 0 and outcome.trusted_mask & untrusted:
            return f"still trusted: motors {outcome.trusted_mask & untrusted:05b}"
        if state is not None and outcome.state is not state:
            return f"the board is {outcome.state.name}, not {state.name}"
        return ""

    return check


def _at_once(limit_frames: int, *words: str, untrusted: int = 0, state: BoardState | None = None) -> Check:
    """As `_stopped`, and no step later than `limit_frames` after the fault."""
    stopped = _stopped(*words, untrusted=untrusted, state=state)

    def check(outcome: Outcome, clean: Outcome) -> str:
        complaint = stopped(outcome, clean)
        if not complaint and outcome.fault_frame is not None:
            late = outcome.last_step_frame - outcome.fault_frame
            if late > limit_frames:
                return f"the last step came {late} frames after the fault"
        return complaint

    return check


def _homed_well(outcome: Outcome, clean: Outcome) -> str:
    """The run ends well with every joint within 0.1 deg of the undisturbed run."""
    if outcome.result != "ok":
        return f"{outcome.result}: {outcome.text}"
    pairs = zip(outcome.truth.joint_deg, clean.truth.joint_deg, strict=True)
    worst = max(abs(a - b) for a, b in pairs)
    return "" if worst < 0.1 else f"a joint is {worst:.3f} deg off"


def _honest_about_lost_steps(outcome: Outcome, clean: Outcome) -> str:
    """Without encoders nothing sees it: the run ends well, counts are right, the arm is not."""
    if outcome.truth.commanded_steps != clean.truth.commanded_steps:
        return "the counts differ"
    gap = abs(outcome.truth.joint_deg[0] - clean.truth.joint_deg[0])
    return _same(outcome, clean) or ("" if abs(gap - 1.0) < 1e-6 else f"the waist is {gap} deg off, not 1")


def _wrapped(outcome: Outcome, clean: Outcome) -> str:
    """Real and motion frames wrapped during the run, and the steps are the same."""
    if outcome.real_frame < 1 << 32 or not 0 < outcome.motion_frame < 1 << 31:
        return f"nothing wrapped: real frame {outcome.real_frame}, motion frame {outcome.motion_frame}"
    return _same(outcome, clean)


def _told_of_the_full_queue(outcome: Outcome, clean: Outcome) -> str:
    """The host says what was refused; the arm holds on its path, its position still trusted."""
    if outcome.trusted_mask != _ALL or not outcome.refused:
        return f"trusted {outcome.trusted_mask:05b}, {outcome.refused} refused"
    return _stopped("no free slot", state=BoardState.HELD)(outcome, clean)


def _bounded_hand(outcome: Outcome, clean: Outcome) -> str:
    """The pulses are those of the strokes, no more, whatever the fingers do."""
    if outcome.hand_pulses != clean.hand_pulses:
        return f"{outcome.hand_pulses} power pulses, {clean.hand_pulses} expected"
    return _same(outcome, clean)


_ELBOW_WAIST, _SHOULDER_WRIST, _ALL = 0b00101, 0b11010, 0b11111
_FAULT = BoardState.FAULT

CASES: tuple[Case, ...] = (
    Case(1, "flip:p=1e-3", "dropped, sent again, same steps", _noticed, True),
    Case(2, "drop:p=1e-3", "resynchronised, same steps", _noticed),
    Case(2, "insert:p=1e-3", "resynchronised, same steps", _noticed),
    Case(2, "duplicate:p=1e-3", "resynchronised, same steps", _noticed),
    Case(3, "burst:ms=200@0.3/s", "the queue plays on, same steps", _same),
    Case(4, "delay:ms=300@10s", "nothing executed twice, same steps", _same),
    Case(6, "reset@28s", "queue and position gone, home again", _stopped("restarted", untrusted=_ALL), True),
    Case(7, "clock:ppm=100", "same steps", _same),
    Case(7, "clock:ppm=0,jump_ms=1@28s", "same steps", _same),
    Case(8, "host-stall:ms=300@28s", "the queue covers it, same steps", _same),
    Case(8, "host-stall:ms=5000@28s", "holds on the path, nobody resumes by itself", _stopped("silent")),
    Case(9, "unplug@28s/2s", "holds, a user resumes", _stopped("connection"), True),
    Case(
        10,
        "switch-stuck-active:joint=elbow",
        "homing refused, axis named",
        _stopped("elbow", "active", untrusted=0b11100),
    ),
    Case(11, "switch-stuck-inactive:joint=waist", "bounded travel, untrusted", _stopped(untrusted=0b00001)),
    Case(12, "switch-bounce:joint=roll,ms=15", "two passes agree", _homed_well),
    Case(
        13,
        "overflow:board=732@28s",
        "steps stop at once, board and joints named",
        _at_once(3, "overflow", "732", "shoulder", untrusted=_SHOULDER_WRIST, state=_FAULT),
        True,
    ),
    Case(14, "lost-steps:motor=waist,n=40@28s", "unseen without encoders, counts stay true", _honest_about_lost_steps),
    Case(
        15,
        "stall:motor=elbow@28s",
        "OVERFLOW within the counter",
        _stopped("overflow", untrusted=_ELBOW_WAIST, state=_FAULT),
    ),
    Case(16, "hand-jam@27s", "pulses bounded", _bounded_hand),
    Case(
        17,
        "queue-lie:slots=255",
        "refused by name, held, trusted",
        _told_of_the_full_queue,
        program=LONG_TEXT,
    ),
    Case(18, "garbage:bytes=5000@28s", "counted, same steps", _noticed),
    Case(19, "endless-frame:bytes=65536@28s", "dropped at the maximum, same steps", _noticed),
    Case(24, "arm-power@28s", "the counters overflow: fault", _stopped("overflow", state=_FAULT)),
    Case(25, "swap:line=elbow_select,with=waist_select", "shows at homing", _stopped(untrusted=_ALL)),
    Case(25, "line-stuck:line=strobe_724,level=0", "shows at homing", _stopped("waist", untrusted=_ALL)),
    Case(26, "clock-wrap:frames=20000", "wraps while homing, same steps", _wrapped, True),
    Case(26, "clock-wrap:frames=90000,motion_frames=82000", "wraps in the program, same steps", _wrapped),
    Case(27, "identity:major=2", "motion refused, both versions named", _stopped("protocol 2"), True),
    Case(28, "press@5s", "emergency stop while homing", _at_once(3, "emergency", untrusted=_ALL, state=_FAULT)),
    Case(
        28,
        "press@26.7s",
        "emergency stop at the program's start",
        _at_once(3, "emergency", untrusted=_ALL, state=_FAULT),
    ),
    Case(28, "press@28s", "emergency stop in motion", _at_once(3, "emergency", untrusted=_ALL, state=_FAULT), True),
)
ACTED: tuple[Acted, ...] = (
    Acted(14, "verify", "verify finds the joint and the steps", scenarios.lost_steps_verified),
    Acted(17, "host floods the queue", "refused with full state, plays on, same steps", scenarios.flooded_queue, True),
    Acted(28, "stop, homing", "ramps down, nothing sent before runs", scenarios.stop_while_homing),
    Acted(28, "stop, jogging", "ramps down, nothing sent before runs", scenarios.stop_while_jogging),
    Acted(28, "stop, held", "nothing sent before runs", scenarios.stop_while_held),
    Acted(28, "stop, handshake", "ramps down, nothing sent before runs", scenarios.stop_while_shaking_hands),
    Acted(28, "stop, sending again", "ramps down, nothing sent before runs", scenarios.stop_while_retransmitting, True),
)
ELSEWHERE = {
    5: "frames overtaking: tests/sim_board/test_ports.py (virtual CAN), tests/protocol",
    20: "host: clients without a token",
    21: "host: two clients, one lease",
    22: "host: disks",
    23: "host: configuration",
}


def main() -> int:
    """Run the cases and print the table; 1 when one does not end as demanded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", help="rows of the catalogue, comma separated; default: all")
    parser.add_argument("--n", type=float, default=1, help="seeds per case")
    parser.add_argument("--short", action="store_true", help="a selection for continuous integration")
    arguments = parser.parse_args()
    rows = {int(row) for row in arguments.rows.split(",")} if arguments.rows else None
    chosen = [c for c in CASES if (rows is None or c.row in rows) and (c.in_short or not arguments.short)]
    acted = [a for a in ACTED if (rows is None or a.row in rows) and (a.in_short or not arguments.short)]
    failed, runs, began_s = 0, 0, time.perf_counter()
    seeds = range(1, 1 + max(1, int(arguments.n)))
    programs = {case.program for case in chosen}
    clean = {(seed, text): run_case("", seed, text) for seed in seeds for text in programs}
    print(f"{'row':>3}  {'fault':47}{'demanded':46}end")
    everything: list[Case | Acted] = [*chosen, *acted]
    for one in sorted(everything, key=lambda one: one.row):
        complaints = []
        for seed in seeds:
            runs += 1
            if isinstance(one, Case):
                outcome = run_case(one.fault, seed, one.program)
                name, complaint = one.fault, one.check(outcome, clean[seed, one.program])
            else:
                name, complaint = one.name, run_virtual(one.scenario(seed))
            if complaint:
                complaints.append(f"seed {seed}: {complaint}")
        failed += bool(complaints)
        print(f"{one.row:3}  {name:47}{one.demand:46}{'as demanded' if not complaints else 'FAILED'}", flush=True)
        for complaint in complaints:
            print(f"{'':5}{complaint}")
    if rows is None and not arguments.short:
        for row, where in ELSEWHERE.items():
            print(f"{row:3}  {where}")
    verdict = "all as demanded" if not failed else f"{failed} CASES FAILED"
    print(f"faults: {len(chosen) + len(acted)} cases, {runs} runs, {time.perf_counter() - began_s:.0f} s, {verdict}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
