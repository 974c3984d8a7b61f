"""A node process does not carry the libraries of log files; a program that reads logs still does."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = "{'asammdf', 'pandas'} & {name for name, module in sys.modules.items() if module is not None}"


def loaded(program):
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\nprint(sorted({HEAVY}))"],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize("package", ["controller", "plant_sim"])
def test_a_node_process_loads_no_log_files(package):
    program = f"""
import runpy, sys
sys.argv = ["{package}", "--scenario", "no/such/file.toml"]
try:
    runpy.run_module("{package}", run_name="__main__")
except SystemExit as end:
    assert end.code == 2, end.code
assert "can" in sys.modules and "{package}.unit" in sys.modules
"""
    assert loaded(program) == "[]"


def test_a_program_that_has_python_can_already_keeps_its_log_files():
    program = """
import sys
import can
from hil.canbus.lean import leave_out_log_files
leave_out_log_files()
assert can.io.mf4.asammdf is not None
"""
    assert "asammdf" in loaded(program)
