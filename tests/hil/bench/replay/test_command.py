"""`hil replay` as a process: exit codes, one JSON document, files, errors in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest


def hil(*words):
    environment = {**os.environ, "COLUMNS": "80"}
    environment.pop("FORCE_COLOR", None)
    return subprocess.run(
        [sys.executable, "-m", "hil", *map(str, words)],
        capture_output=True, text=True, timeout=120, env=environment, check=False,
    )  # fmt: skip


def test_a_match_is_code_0_and_a_table_without_colour_that_fits_80_columns(lockstep_run):
    done = hil("replay", lockstep_run)
    assert (done.returncode, done.stderr) == (0, "")
    assert "match: the node answers as it was recorded" in done.stdout
    assert "\x1b" not in done.stdout
    table = done.stdout.splitlines()[1:]  # the first line is the path of the log
    assert max(map(len, table)) <= 80


def test_a_deviation_is_code_1_one_json_document_and_files(lockstep_run, tmp_path):
    out = tmp_path / "out"
    done = hil("replay", lockstep_run, "--set", "controller.law=pid", "--json", "--out", out)
    assert (done.returncode, done.stderr) == (1, "")
    told = json.loads(done.stdout)
    assert told["verdict"] == "deviates"
    assert told["first_deviation"]["name"] == "ATO_Status.Law"
    signals = {f"{m['name']}.{s['name']}": s for m in told["messages"] for s in m["signals"]}
    assert signals["ATO_Command.EffortDemand"]["verdict"] == "deviates"
    assert signals["ATO_Command.Crc"]["verdict"] == "ignored"
    assert json.loads((out / "replay.json").read_text()) == told
    assert (out / "replay.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("words", "named"), [([], "Missing argument"), (["no/such/run"], "no/such/run: no such log")]
)
def test_bad_input_is_code_2_and_one_line(words, named):
    done = hil("replay", *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert named in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
