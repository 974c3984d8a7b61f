"""`hil report` as a user types it, and the report that `hil run` leaves."""

import json
import os
import subprocess
import sys

import pytest


def hil(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "hil", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=cwd,
        env={**os.environ, "COLUMNS": "100", "DISPLAY": "", "WAYLAND_DISPLAY": ""},
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run in which report.html could not be written: its name is taken by a directory."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "a" / "report.html" / "taken").mkdir(parents=True)
    done = hil("run", "--lockstep", "-i", "virtual", "--out", folder / "a", cwd=folder)
    return done, folder / "a"


def test_a_report_that_cannot_be_written_costs_one_line_and_no_result(run):
    done, folder = run
    assert done.returncode == 0, done.stderr
    assert "passed" in done.stdout
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("hil run: no report.html:")
    assert f"hil report {folder}" in line
    assert json.loads((folder / "summary.json").read_text())["verdict"] == "passed"


def test_one_run_and_two_runs(run, tmp_path):
    _, folder = run
    alone = hil("report", folder, "--out", tmp_path / "a.html", cwd=tmp_path)
    assert alone.returncode == 0, alone.stderr
    assert alone.stdout.startswith(f"report: {tmp_path / 'a.html'}")
    both = hil("report", folder, folder, "--json", "--open", cwd=tmp_path)
    assert both.returncode == 0, both.stderr
    document = json.loads(both.stdout)
    assert document["report"] == str(folder.parent / "comparison.html")
    assert [row["verdict"] for row in document["runs"]] == ["passed", "passed"]
    assert document["bytes"] == (folder.parent / "comparison.html").stat().st_size
    assert "no browser could be opened" in both.stderr


def test_no_run_is_one_line_and_exit_code_2(tmp_path):
    done = hil("report", tmp_path / "nothing", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert "no run there" in done.stderr
