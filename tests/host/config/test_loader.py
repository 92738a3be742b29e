"""Configurations: what is shipped loads, what is wrong is named with file, line, key and remedy."""

from pathlib import Path

import pytest

from rm501_host.config import JOINT_NAMES, ConfigError, load_config
from rm501_host.config.board import board_config_from
from rm501_protocol.board_config import INPUT_LINES, OUTPUT_LINES, RM501_BOARD, output_bit

ROOT = Path(__file__).parents[3]
SHIPPED = sorted((ROOT / "configs").glob("*.toml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_every_shipped_configuration_loads_and_its_board_has_no_contradiction(path: Path) -> None:
    assert board_config_from(load_config(path)).problems() == ()


def test_the_packaged_default_is_the_shipped_file() -> None:
    packaged = ROOT / "host" / "rm501_host" / "data" / "rm501.toml"
    assert packaged.read_bytes() == (ROOT / "configs" / "rm501.toml").read_bytes()
    assert load_config() == load_config(ROOT / "configs" / "rm501.toml")


def test_thesis_differs_from_the_default_in_frame_and_coordinates_only() -> None:
    default, thesis = load_config(), load_config(ROOT / "configs" / "thesis.toml")
    assert thesis.frame.rpy_deg == (180.0, 0.0, 0.0)
    assert thesis.frame.xyz_mm == (0.0, 0.0, 160.0)
    assert thesis.machine.coordinates == "XYZABC"
    for section in ("geometry", "tool", "joints", "motors", "drive", "hand", "board", "link", "planner", "keep_out"):
        assert getattr(default, section) == getattr(thesis, section)


def test_the_home_position_is_the_thesis_s() -> None:
    assert load_config().home_deg == (0.0, 100.0, -90.0, 0.0, 0.0)
    assert [joint.home.sequence for joint in load_config().joints.ordered] == list(range(len(JOINT_NAMES)))


WRONG = [
    ("[joints.waist]\nmin_deg = 151.0\n", 3, "joints.waist.min_deg", "swap"),
    ("[geometry]\n\na2_mm = -3.0\n", 4, "geometry.a2_mm", "> 0"),
    ("[geometry]\nfoo = 1\n", 3, "geometry.foo", "not a key"),
    ("[geometry]\nd1_mm = nan\n", 3, "geometry.d1_mm", "finite"),
    ("[frame]\nxyz_mm = [0.0, inf, 0.0]\n", 3, "frame.xyz_mm[1]", "finite"),
    ('[machine]\ncoordinates = "XYZ"\n', 3, "machine.coordinates", "XYZ"),
    ("[geometry]\nd1_mm = true\n", 3, "geometry.d1_mm", "float"),
    ("[drive]\nwrist_matrix = [[1.0, 1.0], [1.0, 1.0]]\n", 3, "drive.wrist_matrix", "singular"),
    ("[joints.waist.home]\nlatch_deg_s = -4.0\n", 3, "joints.waist.home.latch_deg_s", "opposite"),
    ("[joints.waist.home]\nsearch_deg_s = 4.0\n", 3, "joints.waist.home.search_deg_s", "sign"),
    ("[joints.waist.home]\nhome_deg = 170.0\n", 3, "joints.waist.home.home_deg", "inside"),
    ('[joints.waist.home]\ninput = "SWITCH_HIP"\n', 3, "joints.waist.home.input", "SWITCH_WAIST"),
    ("[joints.roll.home]\nsequence = 3\n", None, "joints.waist.home.sequence", "0 to 4"),
    ("[motors.waist]\nmax_rate_steps_s = 1600.0\n", 3, "motors.waist.max_rate_steps_s", "1562.5"),
    ("[planner]\nstop_acceleration_ratio = 1.5\n", 3, "planner.stop_acceleration_ratio", "at least"),
    ("[board]\ntable = [1]\n", 3, "board.table", "entries"),
    ('[[keep_out.boxes]]\nname = "b"\nmin_mm = [0.0, 0.0, 0.0]\nmax_mm = [1.0, 0.0, 1.0]\n', 4, "keep_out", "max_mm"),
    ("[joints.pitch.home]\nignore_limits = false\n", 3, "joints.pitch.home.ignore_limits", "open side"),
    ("[joints.elbow]\nbacklash_deg = 3.2\n", 3, "joints.elbow.backlash_deg", "no play any more"),
    ("[motors.waist]\nbacklash_deg = 0.2\n", 3, "motors.waist.backlash_deg", "0 for the others"),
    ('[board]\ndigital_outputs = ["0.2"]\n', 3, "board.digital_outputs", "free"),
    ("[gcode.outputs]\nM3 = [0, true]\n", 3, "gcode.outputs.M3", "no output"),
    ("[geometry\n", 2, "", "TOML"),
]


@pytest.mark.parametrize(("text", "line", "key", "word"), WRONG, ids=[row[2] or "syntax" for row in WRONG])
def test_what_is_wrong_is_named_with_its_place(
    tmp_path: Path, text: str, line: int | None, key: str, word: str
) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f'extends = "{ROOT / "configs" / "rm501.toml"}"\n{text}')
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    problem = caught.value.problems[0]
    assert problem.key.startswith(key)
    assert word in str(problem)
    if line is not None:
        assert (problem.file, problem.line) == (str(path), line)
    assert problem.remedy


def test_a_missing_file_a_missing_key_and_a_circle(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load_config(tmp_path / "none.toml")
    bare = tmp_path / "bare.toml"
    bare.write_text("[geometry]\nd1_mm = 2.0\n")
    with pytest.raises(ConfigError, match="is missing"):
        load_config(bare)
    circle = tmp_path / "circle.toml"
    circle.write_text('extends = "circle.toml"\n')
    with pytest.raises(ConfigError, match="circle"):
        load_config(circle)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"a = 1\n\xff\xfe")
    with pytest.raises(ConfigError, match=r"binary.toml:2: .*UTF-8"):
        load_config(binary)


def test_the_default_board_needs_no_pages() -> None:
    assert board_config_from(load_config()).hash == RM501_BOARD.hash


def test_wiring_options_move_the_pins(tmp_path: Path) -> None:
    path = tmp_path / "wired.toml"
    path.write_text(
        f'extends = "{ROOT / "configs" / "rm501.toml"}"\n[board.wiring]\n'
        "swap_wrist_selects = true\nswap_wrist_switches = true\nmotor_power = false\nheartbeat = false\nestop = false\n"
    )
    board = board_config_from(load_config(path))
    normal = {line.name: line for line in OUTPUT_LINES}
    bits = {pin.bit: pin.source for pin in board.pins.outputs}
    assert bits[output_bit(1, 5)] == normal["LEFT_WRIST_SELECT"].source
    assert bits[output_bit(1, 6)] == normal["RIGHT_WRIST_SELECT"].source
    assert output_bit(0, 16) not in bits
    assert output_bit(0, 14) not in bits
    switches = {line.name: pin for line, pin in zip(INPUT_LINES, board.inputs.inputs, strict=True)}
    lines = {line.name: line for line in INPUT_LINES}
    assert switches["SWITCH_ROLL"].bit == lines["SWITCH_PITCH"].bit
    assert switches["ESTOP"].role == 0
    assert board.problems() == ()


def test_the_silence_that_switches_power_off_reaches_the_board(tmp_path: Path) -> None:
    path = tmp_path / "careful.toml"
    path.write_text(f'extends = "{ROOT / "configs" / "rm501.toml"}"\n[board]\nidle_power_off_ms = 5000\n')
    assert board_config_from(load_config(path)).link.idle_power_off_ms == 5000
    assert board_config_from(load_config(None)).link.idle_power_off_ms == 0
