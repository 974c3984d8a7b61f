"""What goes wrong with the recording at the end costs a line, not the run's result."""

import json
from dataclasses import replace

import pytest

from hil.bench import run
from hil.bench.outcome import RunOptions
from hil.bench.scenario import load_scenario
from hil.canbus.transport import BusOptions
from hil.record.errors import RecordingUnreadable


@pytest.fixture
def options(tmp_path):
    scenario = load_scenario("metro_1500m", scratch=tmp_path)
    scenario.write(tmp_path / "scenario.toml")
    return RunOptions(scenario, tmp_path, BusOptions("virtual", "end"), lockstep=True)


def test_recorder_that_did_not_end_well_and_verdict_that_cannot_be_added_are_said(options, monkeypatch):
    def refuse(recording, summary):
        raise RecordingUnreadable(f"{recording}: the verdict could not be added: no space")

    real = run.run_in_one_process

    def without_last_words(*arguments, **more):
        return replace(real(*arguments, **more), recorder={})

    monkeypatch.setattr(run, "add_verdict", refuse)
    monkeypatch.setattr(run, "run_in_one_process", without_last_words)
    told = []
    summary = run.run_scenario(options, show=lambda view, speedup: None, tell=told.append)
    assert summary["ended"] == "arrived"
    assert json.loads((options.out / "summary.json").read_text())["ended"] == "arrived"
    assert len(told) == 2
    assert "recorder.log" in told[0]
    assert "summary.json only" in told[1]
    assert "no space" in told[1]
    assert run.exit_code(summary) == 1  # nobody knows what was lost: that does not pass
