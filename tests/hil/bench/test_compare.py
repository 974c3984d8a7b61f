"""Comparisons: who runs what, that nothing is dropped, and what is left on disk. Real runs are few."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from hil.bench import compare as compare_module
from hil.bench.bare import bare_run
from hil.bench.compare import Comparison, Request, compare, trials
from hil.bench.comparison_files import write_files
from hil.bench.comparison_picture import draw_picture
from hil.bench.contender import Contender, contenders
from hil.bench.metrics import ControlMetrics
from hil.bench.sets import NOMINAL, Draw, draws
from hil.bench.trial import (
    Lines,
    Trial,
    TrialResult,
    judge,
    overshoot_percent,
    true_effective_mass_kg,
    try_out,
)
from hil.canbus.contract import Contract

LAWS = contenders("pid,fuzzy_d", ("pid", "fuzzy_d"))


@pytest.fixture(scope="module")
def contract():
    return Contract.load()


def made_up(
    contender: Contender, draw: Draw, stop_error_m: float | None = 0.01, failure: str = ""
) -> TrialResult:
    time_s = np.arange(0.0, 10.0, 0.01)
    speed = 5.0 * np.sin(np.pi * time_s / 10.0)
    lines = Lines(
        time_s, np.cumsum(speed) * 0.01, speed * 0.999, speed, np.gradient(speed, 0.01), 1e4 * speed
    )
    metrics = ControlMetrics(0.01, 0.02, -1.0, stop_error_m, 0.8, 0.1, 10.0, 1e6, 0.0)
    return TrialResult(contender, draw, failure, metrics, lines=lines if draw is NOMINAL else None)


def test_nominal_runs_come_first_and_every_law_meets_the_same_trains():
    request = Request("fuzzy_d_2km", LAWS, runs=3, set_name="full", seed=4)
    plans = trials(request)
    assert len(plans) == request.total == 8
    assert [plan.keep_lines for plan in plans] == [True] * 2 + [False] * 6
    by_law = [[plan.draw for plan in plans if plan.contender == law] for law in LAWS]
    assert by_law[0] == by_law[1] == [NOMINAL, *draws("full", 3, 4)]


def test_what_goes_wrong_in_a_run_is_its_result(contract):
    result = try_out(Trial("fuzzy_d_2km", ("journey.to=Nowhere",), LAWS[0], NOMINAL), contract)
    assert result is not None
    assert "Nowhere" in result.failure
    assert not result.came_to_run


def test_a_run_that_is_interrupted_is_no_result(contract):
    asked = iter(range(1, 100))
    trial = Trial("fuzzy_d_2km", (), LAWS[0], NOMINAL)
    assert try_out(trial, contract, interrupted=lambda: next(asked)) is None


@pytest.fixture(scope="module")
def two_runs(contract):
    """A good run, and one whose train cannot brake as planned."""
    weak = ("plant.train.brake_factor=0.4", "plant.train.mass_factor=1.2")
    good, bad = (
        bare_run("cat_linh_la_thanh", ('controller.law="fuzzy_d"', *more), contract) for more in ((), weak)
    )
    trial = Trial("cat_linh_la_thanh", (), LAWS[1], NOMINAL, keep_lines=True)
    return judge(trial, good, contract), judge(trial, bad, contract), bad


def test_a_good_run_has_every_number_and_no_failure(two_runs):
    good, _, _ = two_runs
    assert good.failure == ""
    assert all(value is not None for value in good.numbers().values())
    assert abs(good.metrics.stop_error_m) < 0.05
    assert good.overshoot_percent < 1.0
    assert good.lines is not None
    assert np.sqrt(np.mean(good.lines.error_mps**2)) == pytest.approx(good.metrics.rms_speed_error_mps)


def test_a_train_that_cannot_stop_has_failed_and_says_how(two_runs):
    _, bad, _ = two_runs
    assert "its stop" in bad.failure or "supervision took over" in bad.failure
    assert bad.came_to_run


def test_true_mass_is_that_of_the_plant(two_runs):
    _, _, run = two_runs
    train = run.scenario.journey.train
    assert true_effective_mass_kg(run.scenario) == pytest.approx(
        1.2 * train.mass_kg + train.rotating_mass_factor * train.mass_kg
    )


def test_overshoot_is_that_of_the_highest_speed():
    speed = np.array([0.0, 10.0, 10.5, 10.0])
    reference = np.array([0.0, 10.0, 10.0, 10.0])
    zero = np.zeros(4)
    assert overshoot_percent(Lines(zero, zero, speed, reference, zero, zero)) == pytest.approx(5.0)
    assert overshoot_percent(Lines(zero, zero, 0.9 * speed, reference, zero, zero)) == 0.0
    empty = np.empty(0)
    assert overshoot_percent(Lines(*(empty,) * 6)) is None


@pytest.fixture
def quick(monkeypatch):
    """Runs that take no time; `stop_after` of them, then the user asks to stop."""

    def made(trial: Trial, contract: Contract, *, interrupted=None) -> TrialResult:
        if trial.draw.number == 2 and trial.contender.law == "pid":
            return TrialResult(trial.contender, trial.draw, "the train stands 8.0 m past its stop")
        return made_up(trial.contender, trial.draw, 0.01 * trial.draw.number)

    monkeypatch.setattr(compare_module, "try_out", made)
    return made


def test_a_failed_run_is_counted_and_kept_with_its_train(quick, tmp_path: Path):
    heard: list[TrialResult] = []
    comparison = compare(Request("s", LAWS, runs=4, jobs=1), on_result=heard.append)
    assert len(heard) == comparison.done == 10
    content = write_files(comparison, tmp_path)
    pid = content["laws"]["pid"]
    assert (pid["spread"]["runs"], pid["spread"]["failed"], pid["spread"]["no_stop"]) == (4, 1, 1)
    assert pid["spread"]["stop_worst_m"] is None
    assert pid["failures"][0]["settings"] == dict(draws("spec", 2, 1)[1].settings)
    assert content["laws"]["fuzzy_d"]["worst"]["draw"] == 4
    assert json.loads((tmp_path / "compare.json").read_text()) == content
    with (tmp_path / "compare.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    assert [row["failure"] for row in rows if row["failure"]] == ["the train stands 8.0 m past its stop"]
    assert {row["plant.train.mass_factor"] for row in rows if row["draw"] == "0"} == {""}


def test_an_interrupted_comparison_keeps_what_is_there(quick):
    done: list[TrialResult] = []
    comparison = compare(
        Request("s", LAWS, runs=50, jobs=1), on_result=done.append, interrupted=lambda: len(done) >= 7
    )
    assert comparison.interrupted
    assert comparison.done == 7
    assert len(comparison.nominal) == 2


def test_picture_is_drawn_with_and_without_failures(tmp_path: Path):
    request = Request("made_up", (*LAWS, Contender("pid", "paper")), runs=6)
    comparison = Comparison(request)
    for contender in request.contenders:
        comparison.add(made_up(contender, NOMINAL))
        for draw in draws("spec", 6, 1):
            failed = contender.preset is not None and draw.number == 3
            comparison.add(made_up(contender, draw, None if failed else 0.02, "gone" if failed else ""))
    path = draw_picture(comparison, tmp_path)
    assert path is not None
    assert path.stat().st_size > 20_000
    assert draw_picture(Comparison(request), tmp_path) is None


def test_all_cores_give_the_numbers_of_one(contract):
    request = Request("cat_linh_la_thanh", LAWS[:1], runs=1, jobs=2, set_name="full")
    pool = compare(request)
    (plan,) = [plan for plan in trials(request) if plan.draw is not NOMINAL]
    here = try_out(plan, contract)
    assert here is not None
    (there,) = pool.drawn["pid"]
    assert here.came_to_run
    assert there.metrics == here.metrics
    assert there.chatter == here.chatter
    assert there.failure == here.failure
