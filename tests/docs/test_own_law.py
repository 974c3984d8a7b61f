"""The steps of "Write your own law", done to a copy of the source, give a law that drives a train."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import pytest
from documented import ROOT, changes_of, files_of

PAGE = ROOT / "docs/how-to/own-law.md"


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """The source with the page's file added and its changes made; compiled code comes along."""
    copy = tmp_path_factory.mktemp("own-law")
    for package in ("controller", "dbc", "hil", "plant_sim", "studies"):
        shutil.copytree(ROOT / package, copy / package)
    for name, text in files_of(PAGE).items():
        (copy / name).write_text(text, encoding="utf-8")
    for name, before, after in changes_of(PAGE):
        text = (copy / name).read_text(encoding="utf-8")
        assert text.count(before) == 1, f"{name}: found {text.count(before)} times:\n{before}"
        (copy / name).write_text(text.replace(before, after), encoding="utf-8")
    return copy


def hil(changed, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "hil", *arguments],
        cwd=changed,
        env={**os.environ, "PYTHONPATH": str(changed)},
        capture_output=True,
        text=True,
        timeout=240,
    )


def test_the_page_changes_every_file_that_it_names():
    named = {name for name, *_ in changes_of(PAGE)} | set(files_of(PAGE))
    assert {"controller/laws/proportional.py", "controller/laws/selection.py", "dbc/ato_bench.dbc"} <= named


def test_the_law_is_listed_and_drives_the_train_to_its_stop(changed):
    assert "proportional" in json.loads(hil(changed, "list", "--json").stdout)["laws"]
    done = hil(
        changed, "run", "--law", "proportional", "--lockstep", "-i", "virtual", "--out", "run", "--json"
    )
    assert done.stdout, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["law"], summary["ended"]) == ("proportional", "arrived"), done.stderr
    assert done.returncode == 0, summary["criteria"]


def test_its_parameters_have_limits(changed):
    done = hil(changed, "run", "--law", "proportional", "--set", "controller.proportional.kp_per_s=-1")
    assert done.returncode == 2
    assert "controller.proportional.kp_per_s: -1" in done.stderr
