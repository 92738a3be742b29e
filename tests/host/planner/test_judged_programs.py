"""Programs as text, judged from samples and segments by an arithmetic of the judge's own: examples, the shared corpus,
random ones, and what tends to break planners. The preflight must say what the planner says."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from rm501_host.config import Config, load_config
from rm501_host.gcode import GcodeError
from rm501_host.kinematics import Arm
from tests.support.dh_oracle import dh_chain
from tests.support.judge_arm import JudgeArm
from tests.support.judge_plan import judge_plan
from tests.support.judge_program import read_program
from tests.support.judge_text import Judgement, judge_program, preflight
from tests.support.random_programs import Joints, RandomProgram

ROOT = Path(__file__).parents[3]
SHARED = ROOT.parent / "shared" / "gcode" / "programs"
CONFIG = load_config()
SOFT = msgspec.structs.replace(CONFIG, planner=msgspec.structs.replace(CONFIG.planner, jerk_limited=True))
HOME_DEG: Joints = Arm.from_config(CONFIG).home_deg
READY_DEG: Joints = (0.0, 45.0, -60.0, 45.0, 0.0)
EXAMPLES = int(os.environ.get("RM501_PLANNER_EXAMPLES", "2000"))
SOFT_EVERY = 32
"""One random program in so many has its jerk limited."""
PARTS = 4
"""The random programs run in parts, so that several cores share them."""
NO_DEADLINE = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def agreed(
    program: Path,
    start_deg: Joints,
    *,
    segments: bool = True,
    most_places: int = 400,
    config: Config = CONFIG,
) -> Judgement:
    """Judge; nothing may be wrong, and the preflight agrees with the planner about what can be done."""
    found = judge_program(config, program, start_deg, segments=segments, most_places=most_places)
    assert found.wrongs == []
    try:
        report = preflight(config, program, start_deg)
    except GcodeError:
        # after a refused move it stands somewhere else, where an incremental arc may be none
        assert found.refused is not None
        return found
    assert report.ok == (found.refused is None), (found.refused, report.errors)
    if found.refused is None:
        assert not found.unreachable
    else:
        assert found.refused.source is not None
        assert found.refused.remedy
    return found


@pytest.mark.parametrize("name", ["rm501", "thesis"])
def test_the_judges_arm_is_the_product_of_its_dh_matrices_and_its_inverse_finds_back(name: str) -> None:
    config = load_config(ROOT / "configs" / f"{name}.toml")
    arm = JudgeArm.of(config).with_tool(20.0, (7.0, -5.0))
    q = np.random.default_rng(1).uniform(arm.low, arm.high, (100, 5))
    tool = np.eye(4)
    tool[:3, 3] = 7.0, -5.0, 20.0
    tips = dh_chain(q, 230.0, 220.0, 150.0, 95.0, tool)[-1]
    np.testing.assert_allclose(arm.places(q), tips[:, :3, 3], atol=1e-10)
    for joints, tip in zip(q, tips, strict=True):
        np.testing.assert_allclose(arm.rotation(joints), tip[:3, :3], atol=1e-12)
        assert min(np.abs(way - joints).max() for way in arm.goals(arm.program_position(joints))) < 1e-5


@pytest.mark.parametrize("example", sorted((ROOT / "examples").glob("*.ngc")), ids=lambda path: path.stem)
def test_examples(example: Path) -> None:
    config = load_config(ROOT / "configs" / ("thesis.toml" if "pick" in example.stem else "rm501.toml"))
    found = judge_program(config, example, Arm.from_config(config).home_deg)
    assert found.refused is None
    assert found.law is not None and found.segments is not None
    assert found.wrongs == []
    assert found.segments.events or "hand" not in example.stem


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared programs are not here")
def test_shared_programs(tmp_path: Path) -> None:
    """Those that read, about an origin within the arm's reach."""
    origin = (315.0, -10.0, 180.0)
    start = Arm.from_config(CONFIG).ik(origin, 0.0, 0.0).best
    assert start is not None
    offset = "G10 L2 P1 X{} Y{} Z{}\n".format(*origin)
    planned = 0
    for original in sorted(SHARED.glob("*/*.ngc")):
        text = original.read_text()
        program = tmp_path / original.name
        program.write_text(text.replace("\n", "\n" + offset, 1) if text.startswith("%") else offset + text)
        try:
            found = judge_program(CONFIG, program, start.q_deg)
        except GcodeError:
            continue
        assert found.wrongs == [], original
        planned += found.law is not None
    assert planned >= 30


@pytest.mark.parametrize("part", range(PARTS))
@settings(NO_DEADLINE, max_examples=EXAMPLES // PARTS)
@given(number=st.integers(0, 2**32 - 1))
def test_random_programs(tmp_path_factory: pytest.TempPathFactory, part: int, number: int) -> None:
    seed = PARTS * number + part
    sizes_mm = (1e-4, 0.01, 0.5, 3.0, 12.0) if number % 8 == 0 else (1e-4, 0.01, 0.5, 3.0)
    random = RandomProgram(seed, most_moves=2 + (number % 4 == 0), sizes_mm=sizes_mm)
    program = tmp_path_factory.getbasetemp() / f"random{part}.ngc"
    program.write_text(random.text)
    try:
        config = SOFT if number % SOFT_EVERY == 1 else CONFIG
        with_segments = number % 16 == 0 or number % (4 * SOFT_EVERY) == 1
        found = agreed(
            program,
            random.start_deg,
            segments=with_segments,
            most_places=30,
            config=config,
        )
    except GcodeError:
        event("not a program")
        return
    event("refused" if found.refused is not None else "planned")


def judged(tmp_path: Path, *blocks: str, start_deg: Joints = READY_DEG) -> Judgement:
    program = tmp_path / "p.ngc"
    program.write_text("\n".join(("G21 G91 G94 G17", *blocks, "M2", "")))
    return agreed(program, start_deg)


SQUARE = ("G1 X10", "G1 Y10", "G1 X-10", "G1 Y-10")
HARD = {
    "segments of 1e-4 mm": ("G64 P0.5", "F6000", *("G1 X0.0001 Y0.00005", "G1 X0.0001 Y-0.00003") * 60),
    "reversals": ("G64 P3", "F6000", *("G1 X10", "G1 X-10", "G1 X10 Y0.001", "G1 X-10 Y0.001") * 3),
    "a corner of 179.9 deg": ("G64 P1", "F12000", "G1 X20", "G1 X-19.99997 Y0.0349"),
    "tangent arcs": ("G64 P1", "F6000", "G1 X10", "G3 X10 Y10 I0 J10", "G1 Y5", "G2 X5 Y5 I5 J0", "G1 X5"),
    "a full circle": ("G61", "F6000", "G2 I10 J0", "G18 G3 I5 K5", "G19 G2 J-8 K0"),
    "an arc of 359.999 deg": ("G61", "F6000", "G2 X0.000000002 Y0.000174533 I10 J0"),
    "tiny arcs in blends": (
        "G64 P2",
        "F6000",
        "G1 X10",
        "G3 X0.02 Y0.02 J0.02",
        "G1 Y10",
        "G2 X0.01 Y0.01 I0.01",
    ),
    "modes alternating": ("F6000", "G61", SQUARE[0], "G64 P2", SQUARE[1], "G61.1", SQUARE[2], "G64 P0.5", SQUARE[3]),
    "P larger than the moves": ("G64 P20", "F6000", *SQUARE * 2),
    "repeated points": ("G64 P1", "F6000", *(block for side in SQUARE for block in (side, "G1 X0 Y0", "G1 X0"))),
    "moves of 1e-9 mm": ("G64 P1", "F6000", *("G1 X0.000000001",) * 300, "G1 X10"),
    "turns of nothing": ("G64 P1", "F6000", "G1 A0", "G1 A0.00000001", "G1 X5", "G1 B0", "G1 Y5"),
    "a speck that turns far": ("G61", "F6000", "G1 X0.000001 B30", "G1 X0.00001 A10 B-30"),
    "a feed of 0.1": ("G61", "F0.1", "G1 X0.003", "G1 A0.003"),
    "a feed of 1e6": ("G64 P1", "F1000000", *SQUARE, "G1 A10", "G1 B-20"),
    "inverse time": ("G64 P1", "G93", "G1 X10 F30", "G1 Y10 A5 F30", "G1 B10 F20", "G3 X5 Y5 I0 J5 F60"),
    "a turn in inches": ("G61", "G20", "F10", "G1 X0.1", "G1 B0.5", "G1 Z0.1"),
    "rapids in chains": ("G64 P5", "G0 X30", "G0 Y40", "G0 X-20 B40", "G0 Z-30 A10", "F6000", "G1 X5"),
    "wide rapids": ("G64 P0.5", "M111 P1 Q80", "M111 P2 Q30", "M111 P1 Q-60", "M111 P5 Q90", "M111 P1 Q30"),
    "tools": ("F6000", "G61", "G3 X5 Y5 I0 J5", "G43.1 Z20 X5", "G2 I5 J5", "M111 P1 Q5", "G2 I5 J5", "G49", "G1 X5"),
    "naive cam": ("G64 P0.5 Q0.3", "F6000", *("G1 X0.3 Y0.01", "G1 X0.3 Y-0.01", "G1 X0.3 Z0.004") * 20, "G1 Y10"),
    "the hand": ("G64 P1", "F6000", "G1 X5", "M102", "G1 Y5", "G4 P0.25", "G1 X-5", "M101"),
}


@pytest.mark.parametrize("name", HARD)
def test_what_tends_to_break_planners(tmp_path: Path, name: str) -> None:
    found = judged(tmp_path, *HARD[name])
    assert found.refused is None
    assert found.law is not None and found.segments is not None


def test_a_blend_takes_nothing_from_a_move_under_exact_path(tmp_path: Path) -> None:
    """The judge finds 0 deviation in the exact lines only if the corner after them is not rounded."""
    found = judged(tmp_path, "F6000", "G61", "G1 X10", "G64 P2", "G1 Y10", "G1 X10", "G61", "G1 Y10")
    assert found.law is not None
    assert 0.1 < found.law.largest_deviation_mm <= 2.0


def test_the_judge_sees_what_it_is_for(tmp_path: Path) -> None:
    """Each fault, planted in the samples of a legal plan, is told."""
    program = tmp_path / "p.ngc"
    program.write_text("G21 G91 G94\nG61.1\nF2000\nG1 X30\nG1 Y20 B5\nG4 P0.1\nG0 X-5\nM2\n")
    found = judge_program(CONFIG, program, READY_DEG)
    assert found.wrongs == [] and found.plan is not None
    samples = found.plan.sample()
    items = read_program(CONFIG, program, np.array(READY_DEG))

    def verdict(**changes: np.ndarray) -> str:
        names = ("t_s", "q_deg", "tcp_mm", "motor_steps", "line")
        data = {name: changes.get(name, getattr(samples, name)) for name in names}
        return "; ".join(judge_plan(CONFIG, items, data, np.array(READY_DEG)).wrongs)

    assert verdict() == ""
    n = len(samples.t_s)
    quick = samples.t_s / 1.002
    assert "1 ms apart" in verdict(t_s=quick)
    jump = samples.q_deg.copy()
    jump[n // 2 :, 1] += 1e-4
    assert "a limit is exceeded" in verdict(q_deg=jump)
    beside = samples.q_deg + 1e-4 * np.sin(np.linspace(0.0, np.pi, n))[:, None]
    assert "farther from the path" in verdict(q_deg=beside)
    assert "begin" in verdict(q_deg=samples.q_deg + 1e-3)
    assert "not where the joints are" in verdict(tcp_mm=samples.tcp_mm + 1e-6)
    assert "motor_steps" in verdict(motor_steps=samples.motor_steps + 1e-3)
    skipped = samples.q_deg.copy()
    skipped[samples.line >= 5] = skipped[-1]
    assert verdict(q_deg=skipped) != ""
    assert "does not say so" in verdict(line=samples.line[::-1].copy())


def test_the_judge_sees_feeds_that_are_exceeded(tmp_path: Path) -> None:
    """The same samples, judged by a program with lower feeds."""
    program, slower = tmp_path / "p.ngc", tmp_path / "q.ngc"
    text = "G21 G91 G94\nG61.1\nG1 X30 F{}\nG1 B20 F{}\nG93 G1 Y30 F{}\nM2\n"
    program.write_text(text.format(1000, 300, 20))
    found = judge_program(CONFIG, program, READY_DEG)
    assert found.wrongs == [] and found.plan is not None
    samples = found.plan.sample()
    data = {name: getattr(samples, name) for name in ("t_s", "q_deg", "tcp_mm", "motor_steps", "line")}
    for feeds in ((999, 300, 20), (1000, 299, 20), (1000, 300, 19.9)):
        slower.write_text(text.format(*feeds))
        told = judge_plan(CONFIG, read_program(CONFIG, slower, np.array(READY_DEG)), data, np.array(READY_DEG))
        assert told.feed > 1.0 + 1e-6
        assert told.wrongs
