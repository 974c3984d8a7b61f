"""`hil compare` as a user starts it."""

from __future__ import annotations

import json
import signal
import subprocess
import time

import pytest
from e2e_support import HIL, hil, one_line

QUICK = ["compare", "cat_linh_la_thanh"]


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    out = tmp_path_factory.mktemp("compare") / "out"
    done = hil(*QUICK, "--laws", "pid,fuzzy_d", "--runs", "1", "--out", str(out), "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), out


def test_json_is_one_document_and_the_files_are_there(compared):
    content, out = compared
    assert list(content["laws"]) == ["pid", "fuzzy_d"]
    assert (content["done"], content["interrupted"]) == (4, False)
    for name in ("compare.json", "compare.csv", "compare.png", "compare.rrd"):
        assert (out / name).stat().st_size > 0, name


def test_shipped_laws_stop_within_5_cm_on_the_nominal_train(compared):
    for law in compared[0]["laws"].values():
        assert law["nominal"]["failure"] == ""
        assert abs(law["nominal"]["stop_error_m"]) <= 0.05
        assert law["spread"]["failed"] == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--laws", "lqr"], ("lqr", "pid", "fuzzy_d")),
        (["--laws", "pid:wild"], ("controller.pid.preset",)),
        (["--runs", "1", "--set-of", "worst"], ("worst", "spec", "full")),
        (["--set", "plant.train.mass_factor=0"], ("mass_factor", "0", "greater than 0")),
        (["--runs", "-1"], ("--runs", "0")),
        (["--runs", "1", "--set", "plant.train.mass_factor=1.1"], ("mass_factor", "draws it")),
        (["--set", "controller.law=pid"], ("controller.law", "--laws")),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, words):
    done = hil(*QUICK, *arguments)
    assert done.returncode == 2
    line = one_line(done.stderr)
    for word in words:
        assert word in line


def test_a_directory_that_holds_a_comparison_is_not_overwritten(compared):
    done = hil(*QUICK, "--out", str(compared[1]))
    assert done.returncode == 2
    assert "already holds a comparison" in one_line(done.stderr)


def test_ctrl_c_leaves_what_is_computed(tmp_path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*HIL, *QUICK, "--laws", "pid", "--runs", "500", "--jobs", "2", "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    # It says how far it is every ten seconds; by the first time some runs are done.
    assert process.stderr is not None
    said = process.stderr.readline()
    assert "of 501 runs" in said
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 1, stdout + stderr
    assert "Traceback" not in stderr
    assert "interrupted" in stdout
    content = json.loads((out / "compare.json").read_text())
    assert 2 <= content["done"] < 500
    assert content["laws"]["pid"]["spread"]["runs"] == content["done"] - 1
    assert time.monotonic() - begin < 60
