"""A run in memory is the recorded run without the recording: same frames, same verdict."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import can
import pytest

from hil.bench.bare import bare_run
from hil.bench.errors import ScenarioError
from hil.bench.outcome import RunOptions
from hil.bench.run import run_scenario
from hil.bench.scenario import load_scenario
from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.canbus.transport import BusOptions

SETTINGS = ("journey.seed=5", "plant.odometry.speed_noise_mps=0.005", "bus.loss_probability=0.01")
SCENARIO = "cat_linh_la_thanh"


@pytest.fixture(scope="module")
def contract():
    return Contract.load()


@pytest.fixture(scope="module")
def bare(contract):
    frames: list[Frame] = []
    run = bare_run(SCENARIO, SETTINGS, contract, tap=frames.extend)
    return run, frames


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    out: Path = tmp_path_factory.mktemp("recorded")
    scenario = load_scenario(SCENARIO, SETTINGS, scratch=out)
    scenario.write(out / "scenario.toml")
    options = RunOptions(scenario, out, BusOptions("virtual", "bare"), lockstep=True)
    return run_scenario(options, show=lambda view, speedup: None), out


def test_frames_are_those_of_a_recorded_run_byte_for_byte(bare, recorded):
    logged = [(m.arbitration_id, bytes(m.data)) for m in can.LogReader(recorded[1] / "frames.blf")]
    assert len(logged) > 50_000
    assert [(frame.can_id, frame.data) for frame in bare[1]] == logged


def test_judgement_is_that_of_a_recorded_run(bare, recorded, contract):
    run, summary = bare[0], recorded[0]
    metrics = asdict(run.metrics(contract))
    assert run.ending.how == summary["ended"] == "arrived"
    for name, value in metrics.items():
        assert summary["control"][name] == pytest.approx(value, abs=1e-3 if "energy" not in name else 0.06)
    assert summary["control"]["stop_error_m"] == round(metrics["stop_error_m"], 6)
    assert summary["control"]["rms_speed_error_mps"] == round(metrics["rms_speed_error_mps"], 6)
    assert run.lost_on_purpose == summary["bus"]["lost_on_purpose"] > 300
    assert [row["name"] for row in summary["criteria"]].count("frames_lost") == 0


def test_every_probe_has_a_value_for_every_cycle(bare):
    run, _ = bare
    for process in ("controller", "plant_sim"):
        cycles = round(run.simulated_s / 0.01)
        for name in run.probes(process):
            time_s, values = run.probe(process, name)
            assert len(time_s) == len(values) == cycles
        assert len(run.step_us[process]) == cycles


def test_another_seed_loses_other_frames(contract, bare):
    other = bare_run(SCENARIO, (*SETTINGS, "journey.seed=6"), contract)
    assert other.lost_on_purpose != bare[0].lost_on_purpose


def test_an_interrupted_run_ends_at_once(contract):
    asked = iter(range(1, 1000))
    run = bare_run(SCENARIO, (), contract, interrupted=lambda: next(asked))
    assert run.ending.how == "aborted"
    assert run.simulated_s < 1.0


def test_loss_where_the_bench_cannot_decide_it_is_refused(tmp_path):
    scenario = load_scenario(SCENARIO, ("bus.loss_probability=0.01",), scratch=tmp_path)
    for options in (
        RunOptions(scenario, tmp_path, BusOptions("hil", "x"), lockstep=True),
        RunOptions(scenario, tmp_path, BusOptions("virtual", "x")),
    ):
        with pytest.raises(ScenarioError, match="run with --lockstep -i virtual"):
            run_scenario(options, show=lambda view, speedup: None)
