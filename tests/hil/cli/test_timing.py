"""`hil timing` from the command line. Wide bands: this machine may be busy with anything."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

PASSED_OR_FAILED = (0, 1)


def hil(*arguments, timeout=180):
    return subprocess.run(
        [sys.executable, "-m", "hil", "timing", *arguments], capture_output=True, text=True, timeout=timeout
    )


@pytest.mark.realtime
def test_a_short_measurement_gives_one_document_with_every_part(tmp_path):
    done = hil("--duration", "2", "--slices", "1", "--json", "--out", str(tmp_path / "t"))
    assert done.returncode in PASSED_OR_FAILED, done.stderr
    document = json.loads(done.stdout)
    assert document == json.loads((tmp_path / "t/timing.json").read_text())
    assert document["return_code"] == done.returncode
    parts = document["hil"]["conditions"]["idle"]["parts"]
    assert {"loop_plain", "loop_spin", "full"} <= set(parts)
    for name, part in parts.items():
        assert part["cycles"] > 50, name
        assert -1.0 <= part["wakeup_latency_us"]["p50"] < 5_000, name
    full = parts["full"]
    assert 20 < full["execution_us"]["p50"] < 5_000
    assert 0 < full["signal_age_us"]["p50"] < 30_000
    assert 0 < full["command_latency_us"]["p50"] < 30_000
    split = sum(full["execution_split_us"][name]["mean"] for name in full["execution_split_us"])
    assert split == pytest.approx(full["execution_us"]["mean"], rel=0.01)
    assert full["frames_lost"] == 0
    assert (tmp_path / "t/timing.png").stat().st_size > 10_000
    assert (tmp_path / "t/timing.rrd").stat().st_size > 1_000


@pytest.mark.realtime
def test_without_real_time_rights_it_measures_and_says_how_to_get_them(tmp_path):
    """With limits that nothing can hold: it ran, and it failed."""
    limits = tmp_path / "limits.toml"
    limits.write_text("schema = 1\n[execution_us]\np50 = 0.001\n")
    done = hil(
        "--duration", "0.5", "--slices", "1", "--priority", "0", "--spin", "0", "--limits", str(limits),
        "--out", str(tmp_path / "t"),
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "SCHED_OTHER" in done.stdout
    assert "failed" in done.stdout.splitlines()[-2]
    document = json.loads(Path(tmp_path / "t/timing.json").read_text())
    assert document["hil"]["settings"]["sched_fifo"] is False
    assert "loop_spin" not in document["hil"]["conditions"]["idle"]["parts"]


@pytest.mark.realtime
def test_the_nodes_keep_time_as_the_scenario_says(tmp_path):
    scenario = tmp_path / "slow.toml"
    shipped = (files("hil.library") / "scenarios/cat_linh_la_thanh.toml").read_text(encoding="utf-8")
    scenario.write_text(shipped + "\n[timing]\nspin_us = 0\nrehearsal = false\n", encoding="utf-8")
    done = hil(
        "--duration", "0.5", "--slices", "1", "--priority", "0", "--scenario", str(scenario), "--json",
        "--out", str(tmp_path / "t"),
    )  # fmt: skip
    assert done.returncode in PASSED_OR_FAILED, done.stderr
    document = json.loads(done.stdout)
    assert document["hil"]["settings"]["spin"] == "0"
    full = document["hil"]["conditions"]["idle"]["parts"]["full"]
    assert full["spin"]["mode"] == "off"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--period", "5"), "--period 5"),
        (("--duration", "0.001"), "--duration"),
        (("--spin", "much"), "--spin much"),
        (("--priority", "99"), "--priority 99"),
        (("--cpu", "4096"), "--cpu 4096"),
        (("-i", "virtual"), "-i virtual"),
        (("--limits", "nowhere.toml"), "nowhere.toml"),
        (("--witness", "--load"), "--witness"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments, complaint, tmp_path):
    done = hil(*arguments, "--out", str(tmp_path / "t"), timeout=60)
    assert done.returncode == 2
    assert complaint in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert not (tmp_path / "t").exists()
