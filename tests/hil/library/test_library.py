"""The shipped files load, say where their numbers come from, and hold the papers' numbers."""

import math
import tomllib

import numpy as np
import pytest

from hil.railway import RailwayDataError, load_journey, load_line, load_train
from hil.railway.library import (
    find_line,
    find_scenario,
    find_train,
    list_lines,
    list_scenarios,
    list_trains,
)
from hil.railway.resistance import n_to_specific

LINES = [entry for entry in list_lines() if entry.path.suffix == ".toml"]
TRAINS = [entry for entry in list_trains() if entry.path.suffix == ".toml"]
ENTRIES = [*LINES, *TRAINS, *list_scenarios()]
SLIP_CONTROL = 1.06
"""What a drive may ask for above the mean of Curtius/Kniffler: cat_linh_4car carries the paper's optimum."""


def ids(entries):
    return [f"{entry.path.parent.name}/{entry.name}" for entry in entries]


def test_the_library_has_every_paper():
    assert {entry.name for entry in list_lines()} >= {
        "cat_linh_la_thanh",
        "la_thanh_cat_linh",
        "fuzzy_d_2km",
        "metro_1500m",
        "mainline_36km",
    }
    assert {entry.name for entry in list_trains()} >= {
        "cat_linh_4car",
        "urban_4car_80m",
        "metro_smc_252t",
        "metro_smc_305t",
        "mainline_fuzzy_pid",
    }
    assert {entry.name for entry in list_scenarios()} >= {entry.name for entry in LINES}


@pytest.mark.parametrize("entry", ENTRIES, ids=ids(ENTRIES))
def test_every_file_is_named_as_it_says_and_states_its_source(entry):
    tables = tomllib.loads(entry.path.read_text(encoding="utf-8"))
    assert tables["schema"] == 1
    assert tables["name"] == entry.name
    assert entry.title == tables["title"] != ""
    assert any(year in tables["source"] for year in ("2014", "2020", "2021"))
    assert len(tables["source"]) > 80


@pytest.mark.parametrize("entry", LINES, ids=ids(LINES))
def test_every_line_has_balises_at_departure_and_where_the_stop_needs_them(entry):
    line = load_line(entry.path)
    first, last = line.stops[0].position_m, line.stops[-1].position_m
    before_stop = {round(last - balise.position_m, 3) for balise in line.balises}
    assert {300.0, 100.0, 25.0, 5.0} <= before_stop
    assert any(0.0 < balise.position_m - first <= 10.0 for balise in line.balises)
    assert line.end_m > last, "there is track to overrun on"


@pytest.mark.parametrize("entry", TRAINS, ids=ids(TRAINS))
def test_every_train_is_physically_plausible(entry):
    train = load_train(entry.path)
    speeds = np.linspace(0.0, 30.0, 301)
    for v in speeds:
        limit_n = SLIP_CONTROL * train.adhesion_limit_n(v)
        assert train.traction_effort_n(v) <= limit_n, f"slips at full traction at {v} m/s"
    brake = max(train.electrodynamic.effort_n(v) / train.adhesion_limit_n(v) for v in speeds)
    assert brake <= 1.0, "slides at full electrodynamic brake"
    assert train.pneumatic.emergency_effort_n >= train.service_brake_effort_n()
    assert train.pneumatic.holding_effort_n >= train.track_resistance_n(35.0)
    # the traction gives the stated acceleration on level track within what resistance takes
    start = (train.traction_effort_n(0.0) - train.running_resistance_n(0.0)) / train.effective_mass_kg
    assert start >= 0.95 * train.max_acceleration_mps2


@pytest.mark.parametrize("entry", list_scenarios(), ids=ids(list_scenarios()))
def test_every_scenario_is_feasible_with_a_comfortable_plan(entry):
    """0.8 m/s2 down, at most 0.9 up within the effort: the timetable must leave room for it."""
    journey = load_journey(entry.path)
    line, train = journey.line, journey.train
    x = np.linspace(journey.origin.position_m, journey.destination.position_m, 4001)
    edges, limits = line.speed_limit_profile(train.length_m)
    limit = limits[np.searchsorted(edges, x, side="right") - 1]
    step = x[1] - x[0]
    up, down = np.zeros_like(x), np.zeros_like(x)
    for i in range(len(x) - 1):
        resistance = train.running_resistance_n(up[i])
        resistance += train.track_resistance_n(line.mean_specific_resistance(x[i], train.length_m))
        effort = (0.9 * train.traction_effort_n(up[i]) - resistance) / train.effective_mass_kg
        acceleration = min(0.9, 0.9 * train.max_acceleration_mps2, effort)
        up[i + 1] = min(math.sqrt(max(up[i] ** 2 + 2 * acceleration * step, 0.01)), limit[i + 1])
    for i in range(len(x) - 1, 0, -1):
        down[i - 1] = min(math.sqrt(down[i] ** 2 + 2 * 0.8 * step), limit[i - 1])
    speed = np.minimum(up, down)
    fastest_s = float(np.sum(2 * step / (speed[1:] + speed[:-1])))
    assert fastest_s + 1.2 < journey.time_s < 1.1 * fastest_s  # 1.2 s: jerk 0.7 at both ends


def test_cat_linh_has_the_papers_limits_and_falls_half_a_metre():
    line = load_line(find_line("cat_linh_la_thanh"))
    assert line.speed_limit_mps(200.0) == pytest.approx(12.108, abs=5e-4)
    assert line.speed_limit_mps(600.0) == pytest.approx(16.394, abs=5e-4)
    assert line.speed_limit_mps(900.0) == pytest.approx(22.0)
    rise_m = sum((g.end_m - g.start_m) * g.permille for g in line.gradients) / 1000.0
    assert rise_m == pytest.approx(-0.49)
    assert line.mean_specific_resistance(600.0) == pytest.approx(-17.0 + 600.0 / 550.0)


def test_both_directions_of_cat_linh_are_mirror_images():
    there, back = load_line(find_line("cat_linh_la_thanh")), load_line(find_line("la_thanh_cat_linh"))
    for x in np.arange(-70.0, 1000.0, 7.3):
        assert back.gradient_permille(931.0 - x) == -there.gradient_permille(x)
        assert back.speed_limit_mps(931.0 - x) == pytest.approx(there.speed_limit_mps(x), abs=0.05)


def test_cat_linh_train_has_the_papers_mass_and_resistance():
    train = load_train(find_train("cat_linh_4car"))
    assert train.effective_mass_kg == pytest.approx(2 * 37_020 + 2 * 34_160)
    specific = n_to_specific(train.running_resistance_n(10.0), train.mass_kg)
    assert specific == pytest.approx(1.75 + 0.0234 * 36.0 + 0.000184 * 36.0**2)


def test_fuzzy_d_line_has_the_additional_resistance_of_figure_11():
    line = load_line(find_line("fuzzy_d_2km"))
    values = [line.mean_specific_resistance(x) for x in (100, 300, 700, 1050, 1200, 1400, 1700)]
    assert values == pytest.approx([0.0, 6.0, 0.0, 1.2, -4.8, 1.2, 0.0])
    assert [line.speed_limit_mps(x) for x in (500.0, 1200.0)] == pytest.approx([15.0, 10.5])


def test_urban_train_reaches_its_stated_accelerations():
    train = load_train(find_train("urban_4car_80m"))
    assert train.effective_mass_kg == pytest.approx(172_800.0)
    assert train.traction_effort_n(0.0) / train.effective_mass_kg == pytest.approx(1.05)
    assert train.service_brake_effort_n() / train.effective_mass_kg == pytest.approx(1.3)
    assert train.traction_effort_n(15.0) == pytest.approx(1_520_000.0 / 15.0)


@pytest.mark.parametrize(("name", "mass_kg"), [("metro_smc_252t", 252_500.0), ("metro_smc_305t", 305_000.0)])
def test_sliding_mode_train_has_the_papers_forces(name, mass_kg):
    train = load_train(find_train(name))
    assert train.mass_kg == mass_kg
    assert train.effort_n(1.0, 20.0) == pytest.approx(403_000.0)
    assert train.effort_n(-1.0, 20.0) == pytest.approx(-380_000.0, rel=1e-3)  # four digits in the file
    assert train.running_resistance_n(20.0) == pytest.approx(8547.0 + 64.2 * 20.0 + 2.2452 * 400.0)


def test_mainline_climb_and_resistance_are_the_papers():
    line, train = load_line(find_line("mainline_36km")), load_train(find_train("mainline_fuzzy_pid"))
    (climb,) = line.gradients
    assert (climb.end_m - climb.start_m, climb.permille) == (9680.0, 15.0)
    assert train.running_resistance_n(30.0) / train.mass_kg == pytest.approx(0.262, abs=5e-4)


def test_a_path_is_looked_up_beside_first_and_then_where_one_stands(tmp_path, monkeypatch):
    beside = tmp_path / "beside"
    beside.mkdir()
    (tmp_path / "a.toml").write_text("here = 1")
    monkeypatch.chdir(tmp_path)
    assert find_line("a.toml", beside).resolve() == tmp_path / "a.toml"
    (beside / "a.toml").write_text("there = 1")
    assert find_line("a.toml", beside) == beside / "a.toml"
    assert find_scenario(str(tmp_path / "a.toml")) == tmp_path / "a.toml"


def test_unknown_names_and_missing_files_say_what_there_is():
    with pytest.raises(RailwayDataError, match=r"no scenario 'x' in the library; it has .*cat_linh_la_thanh"):
        find_scenario("x")
    with pytest.raises(RailwayDataError, match=r"did you mean metro_smc_252t\?"):
        find_train("metro_smc_252")
    with pytest.raises(RailwayDataError, match=r"^x\.toml: no such scenario file$"):
        find_scenario("x.toml")
