"""Running a program from file to report: check everything, connect, home, play, say what happened.

    check -> plan                                        nothing has moved, any error refuses the whole program
    connect -> configure -> power -> home -> play        the arm moves
    report

The program is checked before the port is even opened, from the home position (or, without homing, from where the
trusted arm stands); `program_plan` says how.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from rm501_host.config import Config
from rm501_host.config.board import board_config_from
from rm501_host.errors import ProgramRefusedError, RefusedError, Rm501Error, StoppedError
from rm501_host.gcode.program_log import ProgramLog
from rm501_host.gcode.resolve import ExternalAction
from rm501_host.gcode.user_m import UserMCodeError
from rm501_host.kinematics import Arm
from rm501_host.motion import Homing, MotionStream, PieceRuns, Progress
from rm501_host.moves import InputWait, Message, Move, Pause, ProbeMove, ProgramEnd
from rm501_host.planner import Limits, Piece, Plan
from rm501_host.planner.pieces import Action
from rm501_host.preflight import ProgramFault
from rm501_host.program import run_external
from rm501_host.program_plan import PlannedProgram, carry_out_notes, check_and_plan
from rm501_host.reading import tell_while_reading
from rm501_host.report import RunReport, WireFigures
from rm501_host.session import BoardRefusedError, BoardSession, open_session
from rm501_host.session.board_session import Notice, WireTap, noise_text
from rm501_host.session.fault_words import fault_text
from rm501_host.tracking import RunFigures
from rm501_host.transports import open_transport
from rm501_protocol.enums import BoardState, HoldCause
from rm501_protocol.link_events import LinkNoisy
from rm501_protocol.messages import Hold, Status

_ARM_MOTORS_MASK = 0b11111


class Watcher(Protocol):
    """Who is told how a run goes."""

    def phase(self, name: str) -> None:
        """A new phase begins: planning, connecting, homing NAME, running."""
        ...

    def progress(self, progress: Progress) -> None:
        """The program has come so far."""
        ...

    def message(self, text: str) -> None:
        """The program, or the host, has something to say to the operator."""
        ...


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How to run: where the board is, whether to home, and what to inject."""

    port_url: str
    home: bool
    nonce: Callable[[], int]
    wire_tap: WireTap | None = None
    wall_clock_s: Callable[[], float] | None = None
    keep_pieces: bool = False


@dataclass(frozen=True, slots=True)
class RunResult:
    """The report, the error that ended the run early, if one did, and with `keep_pieces` the plan as far as played."""

    report: RunReport
    error: Rm501Error | None
    plan: Plan = field(repr=False)


async def run_program(program: Path, config: Config, options: RunOptions, watcher: Watcher) -> RunResult:
    """Run `program` to its end; raises what refuses it before anything moves, returns what ended it later."""
    arm = Arm.from_config(config)
    session: BoardSession | None = None
    planned: PlannedProgram | None = None

    def watched(moves: Iterator[Move | Action]) -> Iterator[Move | Action]:
        def tell(line: int, count: int) -> None:
            if planned is None:  # afterwards the motion shows itself
                watcher.phase(f"checking line {line}, {count} moves so far")

        return moves if options.wall_clock_s is None else tell_while_reading(moves, tell, options.wall_clock_s)

    try:
        if options.home:
            watcher.phase("planning")
            planned = check_and_plan(program, arm, config, config.home_deg, watcher.message, watched)
            _refuse_what_waits(planned)
            session = await _connect(config, options, watcher)
        else:
            session = await _connect(config, options, watcher)
            watcher.phase("planning")
            if Limits.from_config(config).backlash_deg.any():
                watcher.message(
                    "on which side of its play each joint stands is not known: angles may be off by half the play "
                    "until each has moved by as much"
                )
            start_deg = _trusted_position(session, arm)
            # away from the loop: a board that hears nothing for a second takes its host for gone
            planned = await asyncio.get_running_loop().run_in_executor(
                None, lambda: check_and_plan(program, arm, config, start_deg, watcher.message, watched)
            )
            _refuse_what_waits(planned)
        return await _play(program, planned, session, arm, config, options, watcher)
    finally:
        if planned is not None:
            planned.close()
        if session is not None:
            await session.aclose()


def _refuse_what_waits(planned: PlannedProgram) -> None:
    """Nobody is there to answer: what is known to wait for an answer is not even begun."""
    match planned.waits_for:
        case InputWait(source=source):
            raise RefusedError(
                f"{source}: {_WORDS[InputWait]} needs an operator or inputs, `run` has neither; run the program in the "
                "daemon: rm501-host serve, then send"
            )
        case ProbeMove(source=source):
            raise RefusedError(f"{source}: {_WORDS[ProbeMove]} needs a probe, there is none on this machine; remove it")


async def _connect(config: Config, options: RunOptions, watcher: Watcher) -> BoardSession:
    watcher.phase("connecting")
    session = await open_session(
        open_transport(_with_baud(options.port_url, config.link.baud)),
        board_config_from(config),
        options.nonce,
        options.wire_tap,
    )
    try:
        _require_free(await session.refresh_status(), options.port_url)
    except BaseException:
        await session.aclose()
        raise
    return session


def _require_free(status: Status, port_url: str) -> None:
    """Refuse a board on which something is left of an earlier motion: only a person may end that."""
    daemon = f"rm501-host --port {port_url} serve"
    if status.state is BoardState.FAULT:
        raise StoppedError(
            f"a fault is latched, {status.fault.name}: {fault_text(status.fault)}; look at the arm, then: {daemon}, "
            f"and in another terminal: rm501-host reset --fault {status.fault.name}"
        )
    if status.state not in (BoardState.IDLE, BoardState.READY):
        why = "" if status.hold_cause is HoldCause.NONE else f" ({status.hold_cause.name})"
        raise RefusedError(
            f"the board is {status.state.name}{why} in an earlier motion; look at the arm, then: {daemon}, and in "
            "another terminal: rm501-host reset, which drops the rest of that motion"
        )


def _with_baud(url: str, baud: int) -> str:
    """Serial ports take their speed from the configuration unless the URL names one."""
    is_path = url.startswith(("/", "./", "../", "~")) or url.upper().startswith("COM")
    return f"{url}?baud={baud}" if is_path and "?" not in url else url


def _trusted_position(session: BoardSession, arm: Arm) -> tuple[float, ...]:
    status = session.status
    if status is None or status.trusted_mask & _ARM_MOTORS_MASK != _ARM_MOTORS_MASK:
        raise RefusedError("the arm is not homed; run without --no-home, or home it in the daemon (serve, then home)")
    return tuple(float(angle) for angle in arm.joints_from_motors(status.positions_steps[:5]))


async def _play(
    program: Path,
    planned: PlannedProgram,
    session: BoardSession,
    arm: Arm,
    config: Config,
    options: RunOptions,
    watcher: Watcher,
) -> RunResult:
    loop = asyncio.get_running_loop()
    wall_clock_s = options.wall_clock_s or loop.time
    figures = RunFigures(arm, config, keep_pieces=options.keep_pieces)
    error: Rm501Error | None = None
    began_s, wall_began_s = loop.time(), wall_clock_s()
    tell_holds_no_more = session.add_listener(_HoldTeller(watcher))
    session.add_listener(_NoiseTeller(watcher))
    in_motion = False
    log = ProgramLog(program.parent, watcher.message)
    try:
        stream = MotionStream(session, config, someone_resumes=False)
        await stream.prepare()
        if options.home:
            await Homing(stream, arm, config).home_all(lambda joint: watcher.phase(f"homing {joint}"))
        watcher.phase("running")
        in_motion = True
        pieces = carry_out_notes(planned.pieces(), log)
        runs = PieceRuns(figures.of_pieces(pieces))
        while True:
            if await loop.run_in_executor(None, runs.peek):
                await stream.play(runs.until_mark(), watcher.progress, on_segment=figures.add_segment)
            if runs.mark is None or not await _act(runs.mark, config, watcher):
                break
    except (StoppedError, ProgramRefusedError) as ended:
        error = ended
    except BoardRefusedError as refused:
        if not in_motion:
            raise
        # the board takes no more of it: what it has may end in the middle of the path
        watcher.message(await _hold_and_leave(session, "the board refused a part of the motion", options.port_url))
        error = refused
    except asyncio.CancelledError:
        tell_holds_no_more()
        watcher.message("interrupted: bringing the arm to rest on its path")
        watcher.message(await _hold_and_leave(session, "interrupted", options.port_url))
        raise
    finally:
        log.close()
    took_s, wall_s = loop.time() - began_s, wall_clock_s() - wall_began_s
    stats = session.link.stats
    report = RunReport(
        program=str(program),
        result="ok" if error is None else "stopped" if isinstance(error, StoppedError) else "refused",
        cycle_s=round(figures.cycle_s, 6),
        motion_s=round(figures.motion_s, 6),
        segments=figures.segments,
        wire=WireFigures(stats.bytes_out, stats.bytes_in, stats.retransmits, stats.bad_frames),
        limits=figures.limits,
        tracking=figures.tracking,
        speed_ratio=took_s / wall_s if wall_s > 0 else 0.0,
        faults=[] if error is None else [str(error)],
    )
    return RunResult(report, error, Plan(arm, config, figures.pieces))


async def _act(mark: Piece, config: Config, watcher: Watcher) -> bool:
    """Do what a mark asks for, at rest; False at the program's end."""
    match mark.move:
        case Message(text=text):
            watcher.message(text)
        case ProgramEnd():
            return False
        case ProgramFault(error=error):
            raise error
        case ExternalAction() as action:
            try:
                await asyncio.get_running_loop().run_in_executor(None, run_external, config, action)
            except UserMCodeError as failed:
                raise StoppedError(f"{mark.source}: {failed}; the arm stands at rest there") from failed
        case Pause(kind=kind, source=source):
            watcher.message(f"{source}: {kind.value} passed without a pause: nobody is there to continue it")
        case move:
            raise StoppedError(
                f"{mark.source}: {_WORDS.get(type(move), 'this')} needs an operator or inputs; the arm stands at rest "
                "before it; run the program in the daemon: rm501-host serve, then send"
            )
    return True


_WORDS: dict[type[object], str] = {InputWait: "waiting for an input (M66)", ProbeMove: "probing (G38)"}


class _NoiseTeller:
    """Tells the operator once that the line is bad."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._told = False

    def __call__(self, notice: Notice) -> None:
        if isinstance(notice, LinkNoisy) and not self._told:
            self._told = True
            self._watcher.message(noise_text(notice))


class _HoldTeller:
    """Tells the operator once about each hold, why it is and who ends it."""

    def __init__(self, watcher: Watcher) -> None:
        self._watcher = watcher
        self._told = HoldCause.NONE

    def __call__(self, notice: Notice) -> None:
        if not isinstance(notice, Status):
            return
        cause = notice.hold_cause if notice.state is BoardState.HELD else HoldCause.NONE
        if cause is not self._told and cause in _HOLDS:
            self._watcher.message(_HOLDS[cause])
        self._told = cause


_HOLDS = {
    HoldCause.USER: "held on the path by a user; resume goes on",
    HoldCause.BUTTON: "held on the path by the HOLD button; CYCLE START goes on, Ctrl-C gives up",
    HoldCause.OVERRIDE: "held on the path: the feed override is 0",
}


async def _hold_and_leave(session: BoardSession, why: str, port_url: str) -> str:
    """Bring the arm to rest on its path before this process ends; what to tell the operator."""
    try:
        status = await session.refresh_status()
        if status.state is BoardState.RUNNING:
            status = await session.command(Hold(), lambda now: now.state in (BoardState.HELD, BoardState.READY))
    except Rm501Error as error:
        return f"{why}, and the board could not be told: {error}; it holds by itself when the link is silent"
    if status.state is BoardState.HELD:
        trust = "trusted" if status.trusted_mask & _ARM_MOTORS_MASK == _ARM_MOTORS_MASK else "not trusted"
        return (
            f"{why}: the arm holds on its path, motors on, position {trust}; what is left of the motion is dropped by: "
            f"rm501-host --port {port_url} serve, and in another terminal: rm501-host reset"
        )
    return f"{why}: the arm is at rest, the board {status.state.name}"
