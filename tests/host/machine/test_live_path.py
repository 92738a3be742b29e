"""Override above 100 % and running back while a program runs: judged at the pins and from the segments played."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from rm501_host.config import load_config
from rm501_host.errors import RefusedError, StoppedError
from rm501_host.kinematics import Arm
from rm501_host.machine import MachineState, operations
from rm501_host.motion import LivePath, Missed
from rm501_host.planner import Planner
from rm501_host.planner.run_back import KEPT_S
from rm501_host.session import BoardRefusedError
from rm501_host.virtual_time import run_virtual
from rm501_protocol.board_config import output_bit
from rm501_protocol.messages import MotionEnded, Refused, Start, Truncate, Truncated
from rm501_protocol.segment_message import Segment
from rm501_protocol.transport import Receiver, Transport
from tests.host.planner.programs import PICK_START_DEG, pick_and_place
from tests.support.live_cell import LiveCell, Reference, judge, live_cell, played, trial, undisturbed, until
from tests.support.plan_checker import motor_matrix, tool_positions
from tests.support.virtual_machine import ME, OTHER

Array = NDArray[np.float64]


def in_cell(folder: Path, scenario: Callable[[LiveCell, Reference], Any], runs: int = 2, **options: Any) -> None:
    async def main() -> None:
        async with live_cell(folder, **options) as cell:
            await scenario(cell, await undisturbed(cell, runs))

    run_virtual(main())


async def held(cell: LiveCell, after_s: float) -> None:
    machine = cell.service.machine
    await asyncio.sleep(after_s)
    await machine.hold(ME)
    await until(lambda: machine.state is MachineState.HELD)


async def went_back(cell: LiveCell) -> None:
    await until(lambda: cell.service.machine.waiting_for == "run back")


def test_the_override_changes_at_random_instants(tmp_path: Path) -> None:
    """More of them: python -m benchmarks.live_path."""

    async def scenario(cell: LiveCell, reference: Reference) -> None:
        rng = random.Random(1)
        instants = cuts = 0
        while instants < 25:
            run = await trial(cell, reference, rng, backs=False, most_acts=40)
            assert not run.wrong, run
            instants += len(run.acts)
            cuts += run.cuts
        assert cuts >= 2

    in_cell(tmp_path, scenario)


def test_the_arm_runs_back_from_random_instants(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        rng = random.Random(4)
        backs = 0
        while backs < 4:
            run = await trial(cell, reference, rng, backs=True, most_acts=12)
            assert not run.wrong, run
            backs += sum("back" in act for act in run.acts)

    in_cell(tmp_path, scenario)


def test_twice_the_feed_in_mid_program_takes_between_half_and_all_of_the_time(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        loop = asyncio.get_running_loop()
        took = []
        for after_s in (0.0, 5.0):
            began_s = loop.time()
            if after_s == 0.0:
                await machine.set_override(2.0, ME)
            with played() as log:
                job = await programs.run(ME, "live.ngc")
                await asyncio.sleep(after_s)
                await machine.set_override(2.0, ME)
                while not job.done.is_set():
                    assert 0.0 <= programs.progress <= 1.0
                    await asyncio.sleep(0.2)
                await job.wait()
            took.append(loop.time() - began_s)
            assert log.cuts == (1 if after_s else 0)
            await machine.set_override(1.0, ME)
        assert took[0] < took[1] - 0.5 < reference.duration_s - 1.0
        assert machine.plan_scale == 1.0
        scales = [record.data["new"] for record in machine.log.ring if record.kind == "plan_scale"]
        assert scales == [2.0, 1.0] * 2

    in_cell(tmp_path, scenario)


def test_outputs_on_the_way_keep_their_places_through_overrides_and_running_back(tmp_path: Path) -> None:
    """M62 and M63: where the tip is at the edges of the pin, whatever the law; going forward makes no new edge."""
    base = load_config()
    config = msgspec.structs.replace(base, board=msgspec.structs.replace(base.board, digital_outputs=("0.1",)))
    program = (
        "G21 G90 G94 G64 P2 F1200\nG0 X280 Y-40 Z250 A0 B0\nG1 X320\nM62 P0\nG1 Y0\nM63 P0\nG1 X280\nG1 Y-40\nM2\n"
    )

    def edges_mm(cell: LiveCell, first_frame: int) -> list[tuple[int, Array]]:
        """The pin's new level, and the tip's place then."""
        periods = len(config.board.table)
        begin, words = cell.emulator.recording.words(first_frame * periods)
        levels = ((words >> output_bit(0, 1)) & 1).astype(np.int8)
        at = np.flatnonzero(np.diff(levels)) + 1
        steps = cell.emulator.recording.positions_steps((begin + at) // periods)
        q_deg = np.linalg.solve(motor_matrix(config), steps[:, :5].T.astype(np.float64)).T
        return list(zip(levels[at].tolist(), tool_positions(config, q_deg), strict=True))

    async def scenario(cell: LiveCell, _: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        found = []
        for when_s, back_s in ((0.0, 0.0), (1.2, 0.0), (2.0, 2.5)):
            first_frame = cell.frames()
            with played() as log:
                job = await programs.run(ME, "live.ngc")
                if when_s:
                    await asyncio.sleep(when_s)
                    await machine.set_override(2.0, ME)
                if back_s:
                    await held(cell, 0.7)
                    way = await programs.run_back(ME, back_s)
                    assert way.repeats == ("output 0 on (line 4)",)
                    await went_back(cell)
                    assert "going forward repeats: output 0 on (line 4)" in machine.messages[-1]
                    await machine.resume(ME)
                await job.wait()
            assert (log.cuts > 0) == (when_s > 0.0)
            await machine.set_override(1.0, ME)
            found.append(edges_mm(cell, first_frame))
        assert [[level for level, _ in edges] for edges in found] == [[0, 1]] * 3, "on and off, the pin is inverted"
        for edges in found[1:]:
            for (_, place), (_, expected) in zip(edges, found[0], strict=True):
                assert np.linalg.norm(place - expected) < 0.6, "two steps"

    in_cell(tmp_path, scenario, 1, config=config, program=program)


def test_what_did_not_become_faster_is_told_and_tried_again_once_the_wish_changes() -> None:
    config = load_config()
    pieces = tuple(Planner(Arm.from_config(config), config, PICK_START_DEG).plan(pick_and_place(2800.0, 2.0)))
    missed: list[Missed] = []
    live = LivePath(config, missed.append)
    live.begin(pieces)
    live.scale = 2.0
    for for_good in (False, False, False, True):
        assert live.is_respeed_wanted
        live.discard("too late", for_good=for_good)
    assert missed == [Missed(2.0, "too late", False)] * 3 + [Missed(2.0, "too late", True)]
    live.scale = 2.0
    assert not live.is_respeed_wanted
    live.scale = 1.8
    assert live.is_respeed_wanted
    live.scale = 1.0
    assert not live.is_respeed_wanted


def test_an_override_that_never_takes_over_is_logged_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        job = await programs.run(ME, "live.ngc")
        await asyncio.sleep(3.0)
        # as if planning had always taken too long
        monkeypatch.setattr("rm501_host.motion.play.earliest_cut", lambda *_: None)
        await machine.set_override(2.0, ME)
        await until(lambda: bool(machine.messages))
        assert "override 200% waits for the next stop of the path" in machine.messages[-1]
        assert "change the override to try again" in machine.messages[-1]
        misses = [record.data["for_good"] for record in machine.log.ring if record.kind == "override_missed"]
        assert misses == [False, False, False, False, True]
        await job.wait()
        assert machine.stream is not None
        assert machine.stream.positions_steps[:5] == reference.steps[:5]

    in_cell(tmp_path, scenario, 1)


class SlowLine:
    """A line whose bytes to the board take `delay_s`, in order."""

    def __init__(self, inner: Transport) -> None:
        self._inner = inner
        self._due_s = 0.0
        self._is_closed = False
        self.delay_s = 0.0

    @property
    def packets(self) -> bool:
        return self._inner.packets

    @property
    def bytes_per_second(self) -> int | None:
        return self._inner.bytes_per_second

    def start(self, receiver: Receiver) -> None:
        self._inner.start(receiver)

    def write(self, data: bytes) -> None:
        loop = asyncio.get_running_loop()
        self._due_s = max(self._due_s, loop.time() + self.delay_s)
        loop.call_at(self._due_s, self._write, data)

    def _write(self, data: bytes) -> None:
        if not self._is_closed:
            self._inner.write(data)

    async def aclose(self) -> None:
        self._is_closed = True
        await self._inner.aclose()


def test_a_cut_that_comes_too_late_changes_nothing_and_is_tried_again(tmp_path: Path) -> None:
    slow: list[SlowLine] = []

    def slowed(transport: Transport) -> Transport:
        slow.append(SlowLine(transport))
        return slow[-1]

    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        answers: list[object] = []

        def listen(notice: object) -> None:
            if isinstance(notice, Truncated) or (isinstance(notice, Refused) and notice.message_id == Truncate.ID):
                answers.append(type(notice))
            assert not isinstance(notice, MotionEnded)

        machine.session.add_listener(listen)
        with played() as log:
            job = await programs.run(ME, "live.ngc")
            await asyncio.sleep(4.0)
            slow[-1].delay_s = 0.9
            await machine.set_override(2.0, ME)
            await asyncio.sleep(1.0)
            slow[-1].delay_s = 0.0
            await job.wait()
        assert answers[0] is Refused
        assert answers[-1] is Truncated
        assert log.cuts >= 1
        assert machine.stream is not None
        assert machine.stream.positions_steps[:5] == reference.steps[:5]

    base = load_config()
    planner = msgspec.structs.replace(base.planner, stall_budget_s=0.05)
    in_cell(tmp_path, scenario, 1, on_transport=slowed, config=msgspec.structs.replace(base, planner=planner))


def test_back_and_forward_again_with_the_hand_and_the_progress_told(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        job = await programs.run(ME, "live.ngc")
        await asyncio.sleep(1.0)
        with pytest.raises(RefusedError, match="RUNNING; hold it"):
            await programs.run_back(ME, 1.0)
        await held(cell, 8.0)
        before = programs.progress, programs.line
        for wrong in (0.0, -1.0, 31.0, float("nan")):
            with pytest.raises(RefusedError, match="is not above 0 and at most 30"):
                await programs.run_back(ME, wrong)
        assert (await programs.run_back(ME, 5.0)).seconds == pytest.approx(5.0)
        with pytest.raises(RefusedError, match="running back already"):
            await programs.run_back(ME, 1.0)
        await went_back(cell)
        assert machine.state is MachineState.HELD
        assert machine.arm_state.homed == (True,) * 5
        assert programs.progress < before[0]
        assert programs.line < before[1]
        # as far as it came, no farther
        farther = await programs.run_back(ME, KEPT_S)
        assert farther.seconds < 9.0
        await went_back(cell)
        assert programs.progress == pytest.approx(0.0, abs=1e-6)
        with pytest.raises(RefusedError, match="has not moved"):
            await programs.run_back(ME, 1.0)
        await machine.resume(ME)
        await job.wait()
        assert programs.progress == 1.0
        assert machine.arm_state.hand == "OPEN"
        assert machine.stream is not None
        assert machine.stream.positions_steps[:5] == reference.steps[:5]

    in_cell(tmp_path, scenario, 1)


async def held_in_a_stroke(cell: LiveCell) -> None:
    """Held as soon as the hand begins to close in line 7."""
    arm_state = cell.service.machine.arm_state
    await until(lambda: arm_state.hand == "CLOSING")
    await held(cell, 0.0)
    assert arm_state.hand == "CLOSING"


def steps_now(cell: LiveCell) -> list[int]:
    """Step counts of the arm's motors from the pins."""
    steps: list[int] = cell.emulator.recording.positions_steps(np.array([cell.frames() - 1]))[0, :5].tolist()
    return steps


@pytest.mark.parametrize("back_s", [0.1, 0.5])
def test_the_hand_ends_its_stroke_before_the_arm_goes_back(tmp_path: Path, back_s: float) -> None:
    """Held in the middle of one, run back by less than the stroke takes, and forward at once: none is refused, none
    lost.
    """

    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        job = await programs.run(ME, "live.ngc")
        await held_in_a_stroke(cell)
        before = steps_now(cell)
        going_back = asyncio.create_task(programs.run_back(ME, back_s))
        await until(lambda: machine.arm_state.hand == "CLOSED")
        assert steps_now(cell) == before, "the arm left while the hand was closing"
        assert (await going_back).repeats == ("hand closes (line 7)",)
        await went_back(cell)
        await machine.resume(ME)
        await job.wait()
        assert machine.stream is not None
        assert machine.stream.positions_steps[:5] == reference.steps[:5]
        assert machine.arm_state.hand == "OPEN"

    in_cell(tmp_path, scenario, 1)


def test_somebody_resumes_while_running_back_waits_for_the_hand(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        job = await programs.run(ME, "live.ngc")
        await held_in_a_stroke(cell)
        going_back = asyncio.create_task(programs.run_back(ME, 0.5))
        await asyncio.sleep(0.1)
        await machine.resume(ME)
        with pytest.raises(RefusedError, match="not held any more"):
            await going_back
        await job.wait()
        assert machine.stream is not None
        assert machine.stream.positions_steps[:5] == reference.steps[:5]

    in_cell(tmp_path, scenario, 1)


def test_after_an_abort_in_the_middle_of_a_stroke_the_hand_can_be_moved(tmp_path: Path) -> None:
    """Motion time stands since the abort; the hand has had its time long ago."""

    async def scenario(cell: LiveCell, _: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        await programs.run(ME, "live.ngc")
        await held_in_a_stroke(cell)
        await machine.abort(ME)
        await asyncio.sleep(2.0)
        job = operations.hand(machine, ME, opened=True)
        await job.wait()
        assert machine.arm_state.hand == "OPEN"

    in_cell(tmp_path, scenario, 1)


def test_what_the_board_refuses_in_mid_motion_ends_the_program_at_rest_with_its_place(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        before = steps_now(cell)
        job = await programs.run(ME, "live.ngc")
        await asyncio.sleep(5.0)
        assert machine.state is MachineState.RUNNING
        machine.session.post(Segment(1, 10))
        with pytest.raises(BoardRefusedError, match=r"refused Segment in live\.ngc:\d+: .*comes to rest on its path"):
            await job.wait()
        assert machine.state is MachineState.IDLE
        at_rest = steps_now(cell)
        assert at_rest != before, "the program was over"
        await asyncio.sleep(1.0)
        assert steps_now(cell) == at_rest
        assert machine.stream is not None
        moved = np.subtract(at_rest, before)
        assert machine.stream.positions_steps[:5] == tuple(np.add(reference.steps[:5], moved).tolist())
        assert machine.arm_state.homed == (True,) * 5
        await (await programs.run(ME, "live.ngc")).wait()
        assert steps_now(cell) == before

    in_cell(tmp_path, scenario, 1)


def test_a_program_that_pauses_is_run_back_and_comes_forward_to_its_pause(tmp_path: Path) -> None:
    program = "G21 G90 G94\nG61.1\nG0 X270 Y0 Z250 A0 B0\nG1 Y40 F2000\nM0\nG1 Y0\nM2\n"

    async def main() -> None:
        async with live_cell(tmp_path, program) as cell:
            machine, programs = cell.service.machine, cell.service.programs
            job = await programs.run(ME, "live.ngc")
            await until(lambda: machine.waiting_for == "M0")
            there = machine.arm_state.joints_deg
            await programs.run_back(ME, 0.7)
            await went_back(cell)
            assert abs(machine.arm_state.joints_deg[0] - there[0]) > 2.0
            await machine.resume(ME)
            await until(lambda: machine.waiting_for == "M0")
            assert machine.arm_state.joints_deg == pytest.approx(there, abs=1e-9)
            await machine.resume(ME)
            await job.wait()

    run_virtual(main())


def test_running_back_is_refused_without_a_program_by_others_and_after_an_abort(tmp_path: Path) -> None:
    async def scenario(cell: LiveCell) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        with pytest.raises(RefusedError, match="no program is under way"):
            await programs.run_back(ME, 1.0)
        move = operations.move_joints(machine, ME, (10.0, 60.0, -60.0, 60.0, 0.0))
        await held(cell, 0.5)
        with pytest.raises(RefusedError, match="no program is under way"):
            await programs.run_back(ME, 1.0)
        await machine.resume(ME)
        await move.wait()
        job = await programs.run(ME, "live.ngc")
        await held(cell, 2.5)
        machine.lease.take(ME)
        with pytest.raises(RefusedError):
            await programs.run_back(OTHER, 1.0)
        await programs.run_back(ME, 1.0)
        await went_back(cell)
        await machine.abort(ME)
        with pytest.raises(StoppedError):
            await job.wait()
        assert machine.state is MachineState.IDLE
        assert machine.arm_state.homed == (True,) * 5

    async def main() -> None:
        async with live_cell(tmp_path) as cell:
            await scenario(cell)

    run_virtual(main())


def test_a_jerk_limited_program_runs_back_and_gets_faster_in_motion(tmp_path: Path) -> None:
    base = load_config()
    config = msgspec.structs.replace(base, planner=msgspec.structs.replace(base.planner, jerk_limited=True))
    program = "G21 G90 G94\nG61.1\nG0 X270 Y0 Z250 A0 B0\nG1 Y60 F900\nM2\n"

    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine, programs = cell.service.machine, cell.service.programs
        loop = asyncio.get_running_loop()
        with played() as log:
            job = await programs.run(ME, "live.ngc")
            await held(cell, 1.5)
            await programs.run_back(ME, 1.0)
            await went_back(cell)
            await machine.resume(ME)
            await asyncio.sleep(0.5)
            await machine.set_override(2.0, ME)
            began_s = loop.time()
            await job.wait()
        assert loop.time() - began_s < reference.duration_s - 1.0
        assert log.cuts >= 1
        assert 2.0 in [record.data["new"] for record in machine.log.ring if record.kind == "plan_scale"]
        ratios = judge(cell.config, log.segments)
        assert max(ratios.velocity, ratios.acceleration) <= 1.02
        assert ratios.jump_steps_s < 0.5
        assert machine.stream is not None
        assert machine.stream.positions_steps == reference.steps

    in_cell(tmp_path, scenario, 1, config=config, program=program)


def test_the_plan_itself_is_played_while_nobody_wants_more_than_100_percent() -> None:
    """So what goes over the wire is the same, byte for byte, as without a live path."""
    config = load_config()
    pieces = tuple(Planner(Arm.from_config(config), config, PICK_START_DEG).plan(pick_and_place(2800.0, 2.0)))
    live = LivePath(config)
    live.begin(pieces)
    for scale in (1.0, 1.0):
        live.scale = scale
    assert all(a is b for a, b in zip(live, pieces, strict=True))
    assert not live.is_respeed_wanted


def test_a_hold_that_comes_before_the_start_is_ended_by_resume(tmp_path: Path) -> None:
    """The board is held before `Start` arrives and refuses it; the program begins when somebody resumes."""

    async def scenario(cell: LiveCell, reference: Reference) -> None:
        machine = cell.service.machine
        refused: list[Refused] = []
        machine.session.add_listener(lambda notice: refused.append(notice) if isinstance(notice, Refused) else None)
        for delay_s in (0.0, 0.02, 0.05):
            job = await cell.service.programs.run(ME, "live.ngc")
            await until(lambda: machine.state is MachineState.RUNNING)
            await asyncio.sleep(delay_s)
            await machine.hold(ME)
            await until(lambda: machine.state is MachineState.HELD)
            await asyncio.sleep(2.0)
            assert machine.state is MachineState.HELD
            assert machine.job is job
            await machine.resume(ME)
            await job.wait()
            assert job.error is None
        assert any(notice.message_id == Start.ID for notice in refused)

    in_cell(tmp_path, scenario, runs=1)
