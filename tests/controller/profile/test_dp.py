"""Dynamic programming where the problem is convex: the paper's case, the interior point as its peer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.problem import Efforts, Infeasible
from controller.profile.solve import fastest, solve

OPTIMUM_MJ = {"forward": 21.701713, "reverse": 17.274008}
"""Converged optima of the DP paper's two journeys, on a mesh of 16,001 nodes."""
ENERGY_OVER_TIME_MJ = {74: 34.165, 76: 24.864, 78: 21.702, 80: 19.772, 85: 16.347, 90: 14.102, 100: 11.547}
"""Forward journey, on a mesh of about 1 m."""


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_papers_journeys_meet_time_and_energy_at_the_default_mesh(paper_case, direction):
    problem = paper_case(direction)
    solution = solve(problem, "dp")
    assert solution.solver == "dp"
    assert solution.trip_time_s == pytest.approx(problem.time_s, abs=0.01)
    assert solution.traction_j / 1e6 == pytest.approx(OPTIMUM_MJ[direction], rel=1e-3)
    assert solution.speed_mps[0] == solution.speed_mps[-1] == 0.0
    assert np.all(solution.speed_mps <= problem.node_limit_mps + 1e-9)
    assert np.max(solution.acceleration_mps2) <= 1.1 + 1e-6
    assert np.min(solution.acceleration_mps2) >= -1.4 - 1e-6


def test_energy_over_time_is_the_converged_one(paper_case):
    for time_s, energy_mj in ENERGY_OVER_TIME_MJ.items():
        solution = solve(paper_case("forward", float(time_s), max_step_m=1.0), "dp")
        assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)
        assert solution.traction_j / 1e6 == pytest.approx(energy_mj, rel=1e-3)


@pytest.mark.parametrize(
    "changes",
    [
        {"traction": Efforts(None, 2.0e6)},
        {"traction": Efforts(150e3)},
        {"regeneration_efficiency": 0.6},
        {"regeneration_efficiency": 0.8, "braking": Efforts(90e3, 900e3), "traction": Efforts(160e3, 2.2e6)},
        {"regeneration_efficiency": 0.5, "pneumatic": False, "braking": Efforts(140e3)},
        {"start_speed_mps": 9.0},
        {"end_speed_mps": 5.0},
    ],
)
def test_agrees_with_the_interior_point(paper_case, changes):
    problem = paper_case("forward", 82.0, **changes)
    by_point, by_programming = solve(problem, "ip"), solve(problem, "dp")
    assert by_programming.trip_time_s == pytest.approx(82.0, abs=0.01)
    assert by_programming.net_j == pytest.approx(by_point.net_j, rel=1e-3)
    assert by_programming.multiplier_w == pytest.approx(by_point.multiplier_w, rel=0.15)


def test_random_routes_have_the_energy_of_the_interior_point(routes):
    gaps = []
    for seed in range(40):
        problem = routes.random_route(seed)
        problem = problem.with_time(routes.allowance(seed) * fastest(problem).trip_time_s)
        by_point, by_programming = solve(problem, "ip"), solve(problem, "dp")
        assert by_programming.trip_time_s == pytest.approx(problem.time_s, abs=0.01), seed
        assert np.all(by_programming.speed_mps <= problem.node_limit_mps + 1e-9), seed
        scale = max(abs(by_point.net_j), by_point.traction_j)
        gaps.append((by_programming.net_j - by_point.net_j) / scale)
    assert max(gaps) <= 1e-3
    assert min(gaps) >= -1e-4


def test_too_short_a_time_is_infeasible_and_names_the_least_time_and_the_limit(paper_case):
    with pytest.raises(Infeasible, match=r"70 s must be at least 72\.\d+ s") as caught:
        solve(paper_case("forward", 70.0), "dp")
    assert caught.value.min_time_s == pytest.approx(72.88, abs=0.05)
    assert caught.value.binding == "speed limit"


def test_least_time_itself_is_the_fastest_profile(paper_case):
    quickest = fastest(paper_case())
    solution = solve(paper_case("forward", quickest.trip_time_s), "dp")
    assert np.array_equal(solution.speed_mps, quickest.speed_mps)


def test_a_start_from_a_neighbouring_solution_finds_the_same_optimum(paper_case):
    cold = solve(paper_case("forward", 79.0), "dp")
    warm = solve(paper_case("forward", 78.0), "dp", start=cold)
    assert warm.iterations < cold.iterations
    assert warm.traction_j / 1e6 == pytest.approx(OPTIMUM_MJ["forward"], rel=1e-3)


def test_a_steep_descent_needs_no_traction_beyond_the_start(paper_case):
    problem = paper_case("forward", 110.0)
    downhill = replace(problem, track_n_per_kn=np.full(problem.stages, -12.0))
    by_point, by_programming = solve(downhill, "ip"), solve(downhill, "dp")
    assert by_programming.trip_time_s == pytest.approx(110.0, abs=0.01)
    # little beside the 21.7 MJ of the journey on its own gradients
    assert by_programming.traction_j == pytest.approx(by_point.traction_j, rel=0.01)
    assert by_programming.traction_j < 2e6


def test_very_short_hop(paper_case):
    problem = paper_case("forward")
    keep = problem.position_m <= 100.0
    hop = replace(
        problem,
        position_m=problem.position_m[keep].copy(),
        speed_limit_mps=problem.speed_limit_mps[: keep.sum() - 1].copy(),
        track_n_per_kn=problem.track_n_per_kn[: keep.sum() - 1].copy(),
    )
    hop = hop.with_time(1.2 * fastest(hop).trip_time_s)
    assert solve(hop, "dp").net_j == pytest.approx(solve(hop, "ip").net_j, rel=2e-3)
