"""Fixtures of the tests of the documentation."""

import contextlib
import io
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs_hooks"))

from hil.cli import main


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A run as a user has it, which the documented commands may look at."""
    out = tmp_path_factory.mktemp("documented") / "run"
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["run", "--lockstep", "-i", "virtual", "--out", str(out)]) == 0
    return out
