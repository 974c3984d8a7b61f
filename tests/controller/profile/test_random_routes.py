"""Random routes: each is solved or proven infeasible, and behaves as energy over time must."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from controller.profile.problem import Infeasible
from controller.profile.solve import fastest, solve


@pytest.mark.parametrize("hundred", range(5))
def test_500_random_routes_are_solved_or_proven_infeasible(routes, hundred):
    for seed in range(100 * hundred, 100 * hundred + 100):
        problem = routes.random_route(seed)
        least = fastest(problem).trip_time_s  # no limit of force: always feasible with enough time
        with pytest.raises(Infeasible) as caught:
            solve(problem.with_time(0.99 * least), "ip")
        assert caught.value.min_time_s == pytest.approx(least, abs=1e-9)
        time_s = routes.allowance(seed) * least
        solution = solve(problem.with_time(time_s), "ip")
        assert solution.trip_time_s == pytest.approx(time_s, abs=0.01), seed
        assert np.all(solution.speed_mps <= problem.node_limit_mps + 1e-9), seed
        assert np.max(solution.acceleration_mps2) <= 1.1 + 1e-5, seed
        assert np.min(solution.acceleration_mps2) >= -1.4 - 1e-5, seed


def test_a_finer_mesh_never_raises_the_energy_by_more_than_two_parts_in_ten_thousand(routes):
    for seed in range(60):
        coarse, fine, finer = (routes.random_route(seed, max_step_m=step) for step in (10.0, 5.0, 2.5))
        time_s = routes.allowance(seed) * fastest(coarse).trip_time_s
        solutions = [solve(problem.with_time(time_s), "ip") for problem in (coarse, fine, finer)]
        for before, after in pairwise(solutions):
            # of the traction work where the net energy is next to nothing
            assert after.net_j <= before.net_j + 2e-4 * max(abs(before.net_j), before.traction_j) + 500.0, (
                seed
            )


def test_a_longer_time_never_costs_more(routes):
    for seed in range(100):
        problem = routes.random_route(seed)
        least = fastest(problem).trip_time_s
        energies = []
        for share in (1.0, 1.00001, 1.001, 1.01, 1.05, 1.1, 1.2, 1.4, 1.6):
            solution = solve(problem.with_time(share * least), "ip")
            energies.append(solution.net_j)
        # tolerance of the solver, and what a crawl may cost where more time saves nothing
        assert np.all(np.diff(energies) <= 1e-5 * np.abs(energies[:-1]) + 1e-4 * abs(energies[0]) + 10.0), (
            seed
        )


def test_random_routes_have_the_energy_that_ipopt_finds(routes, solve_ipopt):
    for seed in range(12):
        problem = routes.random_route(seed, max_step_m=20.0)
        time_s = routes.allowance(seed) * fastest(problem).trip_time_s
        solution, peer = solve(problem.with_time(time_s), "ip"), solve_ipopt(problem.with_time(time_s))
        # the peer may end in a local optimum; it may not be better
        assert solution.net_j <= peer.net_j + 1e-3 * abs(peer.net_j) + 100.0, seed
