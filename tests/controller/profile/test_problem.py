"""A problem taken from a line: limits, resistances, the other direction, restrictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.problem import Efforts, Problem, mirrored
from controller.profile.profile import ProfileError
from controller.profile.solve import solve
from hil.railway import Curve, Gradient, Line, SpeedLimit, Stop, load_train
from hil.railway.library import find_train

LINE = Line(
    name="hill",
    start_m=-100.0,
    end_m=1100.0,
    default_limit_mps=20.0,
    stops=(Stop("A", 0.0), Stop("B", 1000.0)),
    speed_limits=(SpeedLimit(300.0, 400.0, 12.0),),
    gradients=(Gradient(200.0, 500.0, 8.0), Gradient(500.0, 700.0, -4.0)),
    curves=(Curve(300.0, 400.0, 300.0),),
)


@pytest.fixture(scope="module")
def train():
    return load_train(find_train("cat_linh_4car"))


def _at(problem: Problem, values, place_m: float) -> float:
    return float(values[np.searchsorted(problem.position_m, place_m) - 1])


def test_limits_and_resistances_act_on_the_front_of_a_point_mass(train):
    problem = Problem.of_line(LINE, train, 0.0, 1000.0, 90.0)
    assert {200.0, 300.0, 400.0, 500.0, 700.0} <= set(problem.position_m)
    assert _at(problem, problem.speed_limit_mps, 399.0) == 12.0
    assert _at(problem, problem.speed_limit_mps, 401.0) == 20.0
    assert _at(problem, problem.track_n_per_kn, 350.0) == pytest.approx(8.0 + 600.0 / 300.0)
    assert _at(problem, problem.track_n_per_kn, 600.0) == pytest.approx(-4.0)
    assert problem.node_limit_mps[list(problem.position_m).index(300.0)] == 12.0
    assert problem.length_m == 1000.0


def test_a_limit_lasts_until_the_rear_has_left_it(train):
    problem = Problem.of_line(LINE, train, 0.0, 1000.0, 90.0, train_length_m=79.0)
    assert 479.0 in problem.position_m
    assert _at(problem, problem.speed_limit_mps, 478.0) == 12.0
    assert _at(problem, problem.speed_limit_mps, 480.0) == 20.0
    work = np.sum(problem.track_n_per_kn * np.diff(problem.position_m))
    fronts = np.linspace(0.0, 1000.0, 20_001)
    fine = np.array([LINE.mean_specific_resistance(x, 79.0) for x in 0.5 * (fronts[1:] + fronts[:-1])])
    assert work == pytest.approx(np.sum(fine * np.diff(fronts)), abs=0.5)


def test_the_other_direction_climbs_what_it_descended(train):
    there = Problem.of_line(LINE, train, 0.0, 1000.0, 90.0)
    back = Problem.of_line(LINE, train, 1000.0, 0.0, 90.0)
    assert back.position_m == pytest.approx(1000.0 - there.position_m[::-1])
    assert back.speed_limit_mps == pytest.approx(there.speed_limit_mps[::-1])
    curve = np.array([2.0 if 300.0 < x < 400.0 else 0.0 for x in there.position_m[1:] - 1e-6])
    assert (back.track_n_per_kn - curve[::-1]) == pytest.approx(-(there.track_n_per_kn - curve)[::-1])
    assert mirrored(mirrored(LINE)).gradients == LINE.gradients
    again = Problem.of_line(mirrored(LINE), train, -1000.0, 0.0, 90.0)
    assert solve(again, "ip").net_j == pytest.approx(solve(back, "ip").net_j, rel=1e-9)


@pytest.mark.parametrize(("start", "end"), [(0.0, 1000.0), (1000.0, 0.0)])
def test_a_restriction_lowers_the_limit_in_its_section_of_the_line(train, start, end):
    restriction = SpeedLimit(600.0, 650.0, 5.0)
    problem = Problem.of_line(LINE, train, start, end, 120.0, speed_restrictions=[restriction])
    slow = problem.speed_limit_mps == 5.0
    middles = 0.5 * (problem.position_m[1:] + problem.position_m[:-1])
    line_m = middles if end > start else 1000.0 - middles
    assert np.array_equal(slow, (line_m > 600.0) & (line_m < 650.0))


def test_a_train_is_never_faster_than_it_may_be(train):
    slow = replace(train, max_speed_mps=15.0)
    assert np.max(Problem.of_line(LINE, slow, 0.0, 1000.0, 120.0).speed_limit_mps) == 15.0


def test_efforts_are_the_lowest_of_force_power_and_table():
    efforts = Efforts(100e3, 1e6, ((0.0, 90e3), (5.0, 200e3), (20.0, 40e3)))
    assert efforts.force_n(np.array([0.0, 5.0, 12.5, 20.0])) == pytest.approx([90e3, 100e3, 80e3, 40e3])
    assert np.all(np.isinf(Efforts().force_n(np.array([0.0, 50.0]))))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"time_s": 0.0}, "time_s: 0 must be greater than 0"),
        ({"time_s": float("nan")}, "time_s"),
        ({"mass_kg": -1.0}, "mass_kg: -1 must be greater than 0"),
        ({"start_speed_mps": -1.0}, "start_speed_mps: -1 must be at least 0"),
        ({"traction_efficiency": 1.2}, "traction_efficiency: 1.2 must be above 0 and at most 1"),
        ({"regeneration_efficiency": 1.0}, "no profile is better than another"),
        ({"speed_limit_mps": np.zeros(3)}, "speed limits"),
    ],
)
def test_a_contradiction_is_named(train, change, said):
    problem = Problem.of_line(LINE, train, 0.0, 1000.0, 90.0)
    with pytest.raises(ProfileError, match=said) as caught:
        replace(problem, **change)
    assert "\n" not in str(caught.value)
