"""What the dynamic programming finds may not depend on where it begins, nor on how long the line is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.problem import Efforts
from controller.profile.solve import energy_time_curve, fastest, solve


def gap(problem, solution) -> float:
    """Energy above the interior point's, over what the journey could use: near zero a ratio says nothing."""
    optimum = solve(problem, "ip")
    scale = max(abs(optimum.net_j), optimum.traction_j, 0.02 * fastest(problem).traction_j)
    return (solution.net_j - optimum.net_j) / scale


@pytest.mark.parametrize("share", [0.99, 1.02, 1.1, 1.5])
def test_a_start_from_far_off_never_costs_energy(routes, share):
    for seed in (*range(25), 40):  # 40 needs more than the three tubes of a warm start
        problem = routes.random_route(seed)
        least = fastest(problem).trip_time_s
        problem = problem.with_time(routes.allowance(seed) * least)
        if share * problem.time_s <= least:
            continue
        start = solve(problem.with_time(share * problem.time_s), "dp")
        warm = solve(problem, "dp", start=start)
        assert warm.trip_time_s == pytest.approx(problem.time_s, abs=0.01), seed
        assert gap(problem, warm) <= 1e-3, seed


def test_slow_random_routes_are_within_a_thousandth_of_the_interior_point(routes):
    # 9, 42 and 48 crawl before a stop, where a grid is coarsest
    for seed in (9, 42, 48, *range(100, 130)):
        problem = routes.random_route(seed)
        problem = problem.with_time(1.5 * fastest(problem).trip_time_s)
        solution = solve(problem, "dp")
        assert solution.trip_time_s == pytest.approx(problem.time_s, abs=0.01), seed
        assert gap(problem, solution) <= 1e-3, seed
        assert np.all(solution.speed_mps <= problem.node_limit_mps + 1e-9), seed
        assert np.max(solution.acceleration_mps2) <= 1.1 + 1e-5, seed
        assert np.min(solution.acceleration_mps2) >= -1.4 - 1e-5, seed


def test_where_more_time_saves_nothing_the_train_goes_slower_for_nothing(routes):
    problem = routes.random_route(359)  # 19 permille down, on the average
    quickest = fastest(problem)
    solution = solve(problem.with_time(routes.allowance(359) * quickest.trip_time_s), "dp")
    assert solution.trip_time_s == pytest.approx(routes.allowance(359) * quickest.trip_time_s, abs=0.01)
    assert 0.0 <= solution.traction_j <= 1e-3 * quickest.traction_j
    # a thousandth of the mean power of the fastest run: one more second would save nothing
    assert 0.0 <= solution.multiplier_w <= 1e-3 * quickest.traction_j / quickest.trip_time_s


@pytest.mark.parametrize("share", [1.00002, 1.001, 2.0, 5.0, 10.0])
def test_extreme_trip_times_are_met(paper_case, share):
    problem = paper_case()
    problem = problem.with_time(share * fastest(problem).trip_time_s)
    solution = solve(problem, "dp")
    assert solution.trip_time_s == pytest.approx(problem.time_s, abs=0.01)
    assert gap(problem, solution) <= 1e-3


def test_a_long_route_takes_no_more_passes_than_a_short_one(routes):
    passes = []
    for length_m in (9_000.0, 36_000.0):
        problem = routes.random_route(1, length_m=length_m)
        problem = replace(problem, traction=Efforts(None, 2.2e6), regeneration_efficiency=0.0)
        problem = problem.with_time(1.06 * fastest(problem).trip_time_s)
        solution = solve(problem, "dp")
        assert gap(problem, solution) <= 1e-3
        passes.append(solution.iterations)
    # a pass costs so much a stage, whatever the length
    assert passes[1] <= 1.5 * passes[0]


def test_power_limit_holds_at_both_ends_of_every_stage(paper_case):
    problem = paper_case("forward", 80.0, traction=Efforts(150e3, 1.6e6))
    solution = solve(problem, "dp")
    faster = np.maximum(solution.speed_mps[1:], solution.speed_mps[:-1])
    assert np.max(solution.force_n) <= 150e3 * (1.0 + 1e-5)
    assert np.max(solution.force_n * faster) == pytest.approx(1.6e6, rel=1e-4)


def test_energy_falls_along_a_curve_of_warm_starts(paper_case):
    problem = paper_case()
    times = [74.0, 80.0, 95.0, 78.0]
    curve = energy_time_curve(problem, times)
    chained, before = [], None
    for time_s in times:
        before = solve(problem.with_time(time_s), "dp", start=before)
        chained.append(before.net_j)
    assert chained == pytest.approx([s.net_j for s in curve], rel=1e-3)
