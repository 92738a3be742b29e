"""Declared widths: complete, never left, and small enough together."""

from __future__ import annotations

import random
import runpy

import pytest

from rm501_firmware_model import BoardLayout
from rm501_firmware_model.core import Core
from rm501_firmware_model.memory import BUDGET_BYTES, CONSTANT, FIELDS, packed_bytes, table
from rm501_protocol.board_config import RM501_BOARD
from rm501_protocol.enums import BoardState
from rm501_protocol.messages import Hold, Resume, Start
from tests.firmware_model.programs import LegalMotion
from tests.firmware_model.rig import Rig


def parts(core: Core) -> dict[str, object]:
    """The objects whose fields are declared."""
    objects = (core, core.stepgen, core.queue, core.motion, core.checker, core.hand, core.inputs, core.triggers)
    return {type(item).__name__: item for item in objects}


def test_every_field_is_declared_or_constant() -> None:
    for name, item in parts(Core(BoardLayout(RM501_BOARD), 32, 1)).items():
        fields = FIELDS[name] + (FIELDS["StepGenerator.terms"] if name == "StepGenerator" else ())
        declared = {field.name for field in fields} | set(CONSTANT[name])
        assert declared == {slot for layer in type(item).__mro__ for slot in getattr(layer, "__slots__", ())}


def too_wide(core: Core) -> list[str]:
    """Fields whose value does not fit what is declared."""
    found = []
    for name, item in parts(core).items():
        fields = FIELDS[name] + (FIELDS["StepGenerator.terms"] if name == "StepGenerator" else ())
        for field in fields:
            value = getattr(item, field.name)
            for single in value if isinstance(value, list) else (value,):
                # NEVER stands for the largest u64
                if not field.minimum <= single <= field.maximum:
                    found.append(f"{name}.{field.name} = {single}")
    return found


@pytest.mark.parametrize("seed", range(3))
def test_no_value_leaves_its_width(seed: int) -> None:
    rng = random.Random(seed)
    rig = Rig()
    for segment in LegalMotion(rng).run(25):
        rig.send(segment)
    rig.send(Start())
    while rig.state is not BoardState.READY:
        rig.run(7, 7)
        assert too_wide(rig.core) == []
        if rng.random() < 0.02:
            rig.send(Hold())
        elif rig.state is BoardState.HELD:
            rig.send(Resume())
    rig.pins.toggle(0)
    rig.run(5)
    assert rig.state is BoardState.FAULT
    assert too_wide(rig.core) == []


def test_the_whole_state_fits() -> None:
    layout = BoardLayout(RM501_BOARD)
    assert packed_bytes(layout, 32) <= BUDGET_BYTES
    assert packed_bytes(layout, 33) > packed_bytes(layout, 32)
    assert dict(table(layout, 32))["SegmentQueue"] > 32 * 5 * 12


def test_the_table_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.warns(RuntimeWarning):
        runpy.run_module("rm501_firmware_model.memory", run_name="__main__")
    assert "of 4096, queue of 32 segments" in capsys.readouterr().out
