"""Drawn trains: reproducible, within their bounds, and the same for every law."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.bench.errors import ScenarioError
from hil.bench.scenario import load_scenario
from hil.bench.sets import FULL, NOMINAL, SETS, SPEC, draws


@pytest.mark.parametrize("name", SETS)
def test_every_drawn_value_is_within_its_bounds_and_fills_them(name):
    settings = [draw.settings for draw in draws(name, 400, 1)]
    for uniform in SETS[name]:
        values = np.array([chosen[uniform.key] for chosen in settings])
        span = uniform.high - uniform.low
        assert uniform.low <= values.min() <= uniform.low + 0.02 * span
        assert uniform.high - 0.02 * span <= values.max() <= uniform.high
        assert values.mean() == pytest.approx((uniform.low + uniform.high) / 2, abs=0.06 * span + 1e-12)


def test_a_draw_follows_from_seed_and_number_alone():
    assert draws("full", 5, 7) == draws("full", 50, 7)[:5]
    assert draws("full", 5, 7) != draws("full", 5, 8)
    assert len({draw.settings["journey.seed"] for draw in draws("spec", 100, 1)}) == 100


def test_full_is_spec_and_more_of_the_same_trains():
    spec, full = draws("spec", 10, 3), draws("full", 10, 3)
    assert {uniform.key for uniform in SPEC} < {uniform.key for uniform in FULL}
    for a, b in zip(spec, full, strict=True):
        assert a.settings.items() <= b.settings.items()


@pytest.mark.parametrize("name", SETS)
def test_a_scenario_takes_every_setting_of_a_draw(name, tmp_path: Path):
    draw = draws(name, 1, 1)[0]
    scenario = load_scenario("fuzzy_d_2km", draw.overrides(), scratch=tmp_path)
    plant = scenario.configurations["plant_sim"]
    assert plant.train.mass_factor == draw.settings["plant.train.mass_factor"]
    assert scenario.bus.loss_probability == 0.01
    assert scenario.journey.seed == draw.settings["journey.seed"]


def test_full_spans_the_lags_and_dead_times_it_names_on_the_train_of_the_2_km_line(tmp_path: Path):
    train = load_scenario("fuzzy_d_2km", scratch=tmp_path).journey.train
    bounds = {uniform.key.rpartition(".")[2]: (uniform.low, uniform.high) for uniform in FULL}
    low, high = bounds["time_constant_factor"]
    nominal = train.traction.time_constant_s
    assert (low * nominal, high * nominal) == pytest.approx((0.25, 0.6))
    low, high = bounds["dead_time_factor"]
    nominal = train.traction.dead_time_s
    assert (low * nominal, high * nominal) == pytest.approx((0.05, 0.2))
    low, high = bounds["friction_time_constant_factor"]
    nominal = train.pneumatic.time_constant_s
    assert (low * nominal, high * nominal) == pytest.approx((0.5, 1.0), abs=1e-3)


def test_nominal_changes_nothing():
    assert NOMINAL.overrides() == ()


def test_a_set_that_there_is_not_lists_those_there_are():
    with pytest.raises(ScenarioError, match=r"no such set; there are spec, full") as raised:
        draws("worst", 1, 1)
    assert raised.value.exit_code == 2
