"""The Promela model, where spin is installed: no error, and each seeded bug found."""

import shutil
import subprocess
from pathlib import Path

import pytest

CHECK = Path(__file__).parents[2] / "model" / "check.sh"


@pytest.mark.skipif(not (shutil.which("spin") and shutil.which("cc")), reason="needs spin and a C compiler")
def test_the_model_holds_and_finds_its_seeded_bugs() -> None:
    done = subprocess.run(["sh", str(CHECK)], capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.rstrip().endswith("model: ok")
    assert done.stdout.count("expected 1") == 3
