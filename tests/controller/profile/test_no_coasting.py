"""The plan without coasting keeps its time, its limits, and takes more than the optimum."""

import numpy as np
import pytest

from controller.profile.no_coasting import accelerate_cruise_brake
from controller.profile.problem import Infeasible, Problem
from controller.profile.solve import fastest, solve
from hil.railway import Line, Stop, load_line, load_train
from hil.railway.library import find_line, find_train

TRAIN = load_train(find_train("cat_linh_4car"))
CAT_LINH = load_line(find_line("cat_linh_la_thanh"))


def test_time_and_limits_are_kept():
    problem = Problem.of_line(CAT_LINH, TRAIN, 0.0, 931.0, 78.0)
    plan = accelerate_cruise_brake(problem)
    assert plan.trip_time_s == pytest.approx(78.0, abs=1e-5)
    assert np.all(plan.speed_mps <= problem.node_limit_mps + 1e-9)
    assert plan.min_time_s == pytest.approx(fastest(problem).trip_time_s)


def test_the_optimum_saves_a_fifth_on_cat_linh_la_thanh():
    problem = Problem.of_line(CAT_LINH, TRAIN, 0.0, 931.0, 78.0, max_step_m=0.931)
    plan, best = accelerate_cruise_brake(problem), solve(problem, "ip")
    assert plan.traction_j == pytest.approx(27.70e6, rel=1e-3)
    assert 1.0 - best.traction_j / plan.traction_j == pytest.approx(0.216, abs=1e-3)


def test_on_a_level_line_it_is_the_trapezoid():
    """T = L/v + v/2 (1/a + 1/b) for a trapezoid of cruising speed v; here v = 15 m/s."""
    line = Line(name="level", start_m=0.0, end_m=1000.0, default_limit_mps=30.0,
                stops=(Stop("A", 0.0), Stop("B", 1000.0)))  # fmt: skip
    time_s = 1000.0 / 15.0 + 0.5 * 15.0 * (1.0 / 1.0 + 1.0 / 1.25)
    problem = Problem.of_line(line, TRAIN, 0.0, 1000.0, time_s, max_step_m=1.0,
                              max_acceleration_mps2=1.0, max_deceleration_mps2=1.25)  # fmt: skip
    assert np.max(accelerate_cruise_brake(problem).speed_mps) == pytest.approx(15.0, rel=2e-3)


def test_less_than_the_least_time_is_infeasible():
    with pytest.raises(Infeasible, match="must be at least"):
        accelerate_cruise_brake(Problem.of_line(CAT_LINH, TRAIN, 0.0, 931.0, 60.0))
