"""TTOBench files become lines and trains in SI; what is wrong with one is told in one line."""

import copy
import json
import math

import numpy as np
import pytest

from hil.railway import RailwayDataError, load_line, load_train
from hil.railway.library import find_line, find_train, list_lines, list_trains

TRACK = {
    "metadata": {"id": "test_track", "library version": "TTOBench v1.5"},
    "stops": {"unit": "m", "values": [0.0, 600.0, 2000.0]},
    "speed limits": {
        "units": {"position": "m", "velocity": "km/h"},
        "values": [[0.0, 72], [500.0, 36]],
    },
    "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0.0, 5.0], [1000.0, -3.0]]},
    "curvatures": {
        "units": {"position": "m", "radius at start": "m", "radius at end": "m"},
        "values": [
            [0.0, "infinity", "infinity"],
            [100.0, "infinity", 500.0],
            [200.0, 500.0, 500.0],
            [400.0, 500.0, -500.0],
            [600.0, "infinity", "infinity"],
        ],
    },
    "tunnels": {
        "units": {"position": "m", "length": "m", "cross section": "m^2"},
        "values": [[1200.0, 300.0, 40.0]],
    },
}
TRAIN = {
    "metadata": {"id": "test_train", "library version": "TTOBench v1.5", "description": "Three cars"},
    "mass": {"unit": "t", "value": 100},
    "rho": {"unit": "%", "value": 8},
    "max traction power": {"unit": "kW", "value": 1500},
    "max reg braking power": {"unit": "MW", "value": 2.0},
    "max traction force": {"unit": "kN", "value": 120.0},
    "max reg braking force": {"unit": "N", "value": 90000.0},
    "max speed": {"unit": "km/h", "value": 90},
    "rolling resistance r0": {"unit": "kN", "value": 2.0},
    "rolling resistance r1": {"unit": "kN/(km/h)", "value": 0.01},
    "rolling resistance r2": {"unit": "kN/(km/h)^2", "value": 0.001},
}


@pytest.fixture
def written(tmp_path):
    """Write a track or train with some keys replaced (None: removed); its path."""

    def write(tables, **changes):
        tables = copy.deepcopy(tables)
        for word, value in changes.items():
            key = word.replace("_", " ")
            if value is None:
                del tables[key]
            else:
                tables[key] = value
        path = tmp_path / "file.json"
        path.write_text(json.dumps(tables))
        return path

    return write


def test_sections_of_a_track_last_to_the_next_one_and_to_the_last_stop(written):
    line = load_line(written(TRACK))
    assert (line.start_m, line.end_m) == (0.0, 2000.0)
    assert [stop.name for stop in line.stops] == ["1", "2", "3"]
    assert [line.speed_limit_mps(x) for x in (100.0, 499.0, 501.0, 1999.0)] == pytest.approx([20, 20, 10, 10])
    assert [line.gradient_permille(x) for x in (0.0, 999.0, 1000.0, 1999.0)] == [5.0, 5.0, -3.0, -3.0]
    (tunnel,) = line.tunnels
    assert (tunnel.start_m, tunnel.end_m) == (1200.0, 1500.0)
    assert tunnel.resistance_n_per_kn == pytest.approx(0.00013 * 300.0)


def test_curvature_of_a_transition_is_linear_and_its_work_exact(written):
    line = load_line(written(TRACK, gradients=None, tunnels=None))

    def mean(start_m, end_m):
        return line.track_resistance.mean(end_m, end_m - start_m)

    assert mean(100.0, 200.0) == pytest.approx(0.5 * 600.0 / 500.0)
    assert mean(100.0, 150.0) == pytest.approx(0.25 * 600.0 / 500.0)
    assert mean(200.0, 400.0) == pytest.approx(600.0 / 500.0)
    # right to left: straight in the middle, so on average half of the curve's
    assert mean(400.0, 600.0) == pytest.approx(0.5 * 600.0 / 500.0)
    assert line.mean_specific_resistance(50.0) == line.mean_specific_resistance(1500.0) == 0.0


def test_units_of_a_train_become_si(written):
    train = load_train(written(TRAIN))
    assert (train.mass_kg, train.effective_mass_kg) == pytest.approx((100_000.0, 108_000.0))
    assert train.traction_effort_n(0.0) == 120_000.0
    assert train.traction_effort_n(25.0) == pytest.approx(60_000.0)
    assert train.electrodynamic.curve.max_power_w == 2e6
    assert train.max_speed_mps == pytest.approx(25.0)
    assert train.running_resistance_n(10.0) == pytest.approx(2000.0 + 10.0 * 36.0 + 1.0 * 36.0**2)


def test_what_a_train_leaves_out_has_the_stated_defaults(written):
    train = load_train(written(TRAIN, rho=None))
    assert (train.length_m, train.rotating_mass_factor, train.pneumatic.max_effort_n) == (1.0, 0.0, 0.0)
    coaches = {"unit": "-", "value": 4}
    assert load_train(written({**TRAIN, "num coaches": coaches})).length_m == 100.0
    assert (train.traction_efficiency, train.regeneration_efficiency) == (1.0, 0.0)
    assert train.max_acceleration_mps2 == pytest.approx(1.2)
    assert train.max_braking_mps2 == pytest.approx(0.9)
    assert train.pneumatic.emergency_effort_n > 0.0
    assert train.pneumatic.holding_effort_n > train.track_resistance_n(35.0)


def test_rho_may_be_the_share_that_is_added_or_the_whole_factor(written):
    added = load_train(written(TRAIN, rho={"unit": "-", "value": 0.06}))
    whole = load_train(written(TRAIN, rho={"unit": "-", "value": 1.06}))
    assert added.effective_mass_kg == pytest.approx(whole.effective_mass_kg) == pytest.approx(106_000.0)


def test_keys_that_are_not_used_may_be_there(written):
    path = written({**TRAIN, "ETCS braking data": {"T_be": {"unit": "s", "value": 4}}, "num seats": 3})
    assert load_train(path).title == "Three cars"


@pytest.mark.parametrize(
    ("tables", "changes", "message"),
    [
        (TRACK, {"stops": None}, "stops: is missing"),
        (
            TRACK,
            {"stops": {"unit": "mi", "values": [0.0, 1.0]}},
            "stops.unit: unknown unit 'mi'; .*it has m, km",
        ),
        (
            TRACK,
            {"stops": {"unit": "m", "values": [0.0, 9.0, 9.0]}},
            r"stops.values#3: position 9 must be gr",
        ),
        (TRACK, {"stops": {"unit": "m", "values": [5.0, 9.0]}}, r"stops.values#1: 5 must be 0"),
        (
            TRACK,
            {"speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 0]]}},
            r"speed limits.values#1: 0 must be greater than 0",
        ),
        (
            TRACK,
            {"speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[10, 50]]}},
            r"speed limits.values#1: position 10 must be 0",
        ),
        (
            TRACK,
            {"speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[0, 50, 3]]}},
            r"speed limits.values#1: must have at most 2 entries",
        ),
        (
            TRACK,
            {"gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0, 5], [2000, 1]]}},
            r"gradients.values#2: position 2000 must be less than 2000",
        ),
        (
            TRACK,
            {"gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0, 500]]}},
            r"gradients.values#1: 500 permille must be from -100 to 100",
        ),
        (TRAIN, {"mass": {"unit": "kg", "value": -1}}, r"mass.value: -1 must be greater than 0"),
        (TRAIN, {"mass": {"unit": "kg", "value": "x"}}, r"mass.value: 'x' must be a number"),
        (TRAIN, {"rho": {"unit": "%", "value": 80}}, r"rho.value: 0.8 of the mass must be at most 0.5"),
        (TRAIN, {"max traction force": None}, r"max traction force: is missing"),
        (
            TRAIN,
            {"efficiency traction": {"unit": "%", "value": 170}},
            r"traction_efficiency: 1.7 must be greater than 0 and at most 1",
        ),
    ],
)
def test_what_is_wrong_is_told_with_file_and_key(written, tables, changes, message):
    load = load_line if tables is TRACK else load_train
    with pytest.raises(RailwayDataError, match=f"file.json: {message}") as caught:
        load(written({**tables, **{k: v for k, v in changes.items() if v is not None}}, **{
            k: None for k, v in changes.items() if v is None}))  # fmt: skip
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_json_is_told_in_one_line(tmp_path):
    path = tmp_path / "broken.json"
    path.write_text('{"stops": ')
    with pytest.raises(RailwayDataError, match=r"broken.json: not valid JSON"):
        load_line(path)
    path.write_text("[]")
    with pytest.raises(RailwayDataError, match=r"broken.json: must be a JSON object"):
        load_line(path)
    with pytest.raises(RailwayDataError, match=r"none.json: no such file"):
        load_train(tmp_path / "none.json")


def test_shipped_tracks_and_trains_are_found_and_listed_by_name():
    assert {"CN_Songjiazhuang_Yizhuang", "00_var_speed_limit_100"} <= {entry.name for entry in list_lines()}
    assert {"CN_Beijing_Subway", "NL_Intercity_VIRM6"} <= {entry.name for entry in list_trains()}
    line = load_line(find_line("CN_Songjiazhuang_Yizhuang"))
    train = load_train(find_train("CN_Beijing_Subway"))
    assert len(line.stops) == 14
    assert np.diff([stop.position_m for stop in line.stops])[:3] == pytest.approx([2631.0, 1275.0, 2366.0])
    numbers = (train.mass_kg, train.traction_efficiency, train.regeneration_efficiency)
    assert numbers == pytest.approx((278_000.0, 0.7, 0.8))
    assert train.davis.c_n_per_mps2 == pytest.approx(0.0022294 * 1e3 * 3.6**2)
    assert train.davis.b_n_per_mps == 0.0
    assert (find_line("CN_Songjiazhuang_Yizhuang").parent.parent / "LICENSE").is_file()


def test_a_path_to_json_is_a_line_wherever_lines_are_found(written):
    path = written(TRACK)
    assert find_line(str(path)) == path
    assert find_line(path.name, path.parent) == path
    with pytest.raises(RailwayDataError, match=r"none\.json: no such line file"):
        find_line("none.json")


def test_a_line_capped_by_the_vehicle_has_no_higher_limit():
    line = load_line(find_line("CN_Songjiazhuang_Yizhuang"))
    capped = line.capped(80.0 / 3.6)
    x = np.arange(0.0, 22_728.0, 37.0)
    expected = [min(line.speed_limit_mps(p), 80.0 / 3.6) for p in x]
    assert [capped.speed_limit_mps(p) for p in x] == pytest.approx(expected)
    assert line.capped(math.inf) is line
