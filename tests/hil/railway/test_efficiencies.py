"""Efficiencies between the line and the wheel rim, and the vehicle's own maximum speed."""

import math
from pathlib import Path

import pytest

from hil.railway import RailwayDataError, load_journey, load_train
from hil.railway.library import find_train


@pytest.fixture
def train_file(tmp_path):
    """A shipped train with lines added at its top; its path."""

    def write(more: str) -> Path:
        text = find_train("cat_linh_4car").read_text(encoding="utf-8")
        path = tmp_path / "train.toml"
        path.write_text(text.replace("mass_t = ", f"{more}\nmass_t = ", 1), encoding="utf-8")
        return path

    return write


def test_without_efficiencies_the_line_gives_what_traction_takes():
    train = load_train(find_train("cat_linh_4car"))
    assert (train.traction_efficiency, train.regeneration_efficiency) == (1.0, 0.0)
    assert train.line_energy_j(5.0, 3.0) == 5.0
    assert train.max_speed_mps == math.inf


def test_efficiencies_of_a_file_count_at_the_line(train_file):
    train = load_train(train_file("traction_efficiency = 0.8\nregeneration_efficiency = 0.5"))
    assert train.line_energy_j(8.0, 3.0) == pytest.approx(10.0 - 1.5)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("traction_efficiency = 0.0", "traction_efficiency: 0.0 must be greater than 0"),
        ("traction_efficiency = 1.2", "traction_efficiency: 1.2 must be at most 1"),
        ("regeneration_efficiency = -0.1", "regeneration_efficiency: -0.1 must be at least 0"),
        ("max_speed_kmh = 0.0", "max_speed_kmh: 0.0 must be greater than 0"),
    ],
)
def test_an_impossible_efficiency_is_told(train_file, more, message):
    with pytest.raises(RailwayDataError, match=message):
        load_train(train_file(more))


def test_a_journey_keeps_the_maximum_speed_of_its_train(train_file, tmp_path):
    train_file("max_speed_kmh = 36.0")
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        'schema = 1\nname = "x"\n[journey]\nline = "cat_linh_la_thanh"\ntrain = "train.toml"\n'
        'from = "Cat Linh"\nto = "La Thanh"\ntime_s = 200.0\n'
    )
    journey = load_journey(scenario)
    assert journey.line.speed_limit_profile()[1].max() == pytest.approx(10.0)


def test_the_cat_linh_train_carries_the_optimum_of_its_paper():
    """177 kN and 2.68 MW are the peaks of the paper's problem solved without any drive."""
    train = load_train(find_train("cat_linh_4car"))
    assert train.traction_effort_n(2.68e6 / 177e3) >= 177e3
    assert train.traction.curve.max_power_w == 2_750_000.0
