"""The package's public names, and what it may import."""

import ast
import json
from pathlib import Path

import rm501_protocol

PACKAGE = Path(rm501_protocol.__file__).parent
FORBIDDEN = {"asyncio", "socket", "time", "datetime", "threading", "serial", "can", "numpy", "random", "os", "select"}


def test_public_names_are_pinned() -> None:
    pinned = json.loads((Path(__file__).parent / "public_names.json").read_text())
    assert rm501_protocol.__all__ == pinned
    for name in pinned:
        assert hasattr(rm501_protocol, name)
    assert not hasattr(rm501_protocol, "no_such_name")
    assert set(rm501_protocol._HOMES) == set(pinned)


def test_it_is_sans_io() -> None:
    for path in PACKAGE.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                assert name.split(".")[0] not in FORBIDDEN, f"{path.name} imports {name}"


def test_what_firmware_uses_has_integers_only() -> None:
    """`BoardLink` and all that it stands on: no float literal, no true division, no float()."""
    modules = (
        "board_config board_link can_transfer config_pages declaration framing header link_core messages round_trip "
        "segment segment_message send_window slcan wire_types"
    )
    for module in modules.split():
        for node in ast.walk(ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))):
            assert not (isinstance(node, ast.Constant) and isinstance(node.value, float)), f"{module}: {node.lineno}"
            assert not (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div)), f"{module}: {node.lineno}"
            assert not (isinstance(node, ast.Name) and node.id == "float"), f"{module}: {node.lineno}"


def test_files_stay_small() -> None:
    for path in PACKAGE.glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 440, path.name
