"""Solutions at the edges: replay, short hops, long lines, downhill without traction, time to spare."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.mesh import mesh
from controller.profile.problem import Efforts, Problem
from controller.profile.solve import fastest, solve
from hil.railway import DavisCoefficients


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_a_profile_replayed_at_1_ms_arrives_in_time_with_its_energy(paper_case, direction):
    """The train's equation of motion under the profile's forces, stage by stage, without any control."""
    problem = paper_case(direction)
    solution = solve(problem, "ip")
    mass, davis = problem.effective_mass_kg, problem.davis
    x, v, t, work = 0.0, 0.0, 0.0, 0.0
    edges, force = problem.position_m.tolist(), solution.force_n.tolist()
    track = (problem.track_n_per_kn * problem.mass_kg * 9.81e-3).tolist()
    stage = 0
    while t < 1.1 * problem.time_s and stage < len(force):
        a = (force[stage] - davis.resistance_n(v) - track[stage]) / mass
        rest = edges[stage + 1] - x
        step = min(1e-3, 2.0 * rest / (v + max(v * v + 2.0 * a * rest, 0.0) ** 0.5))  # ends on the node
        dx = v * step + 0.5 * a * step * step
        work += max(force[stage], 0.0) * dx
        x, v, t = x + dx, v + a * step, t + step
        if v <= 0.0:
            break
        stage += step < 1e-3
    assert t == pytest.approx(problem.time_s, abs=0.05)
    assert x == pytest.approx(edges[-1], abs=0.05)
    assert work == pytest.approx(solution.traction_j, rel=1e-3)


def test_the_profile_for_the_reference_begins_where_it_is_told(paper_case):
    solution = solve(paper_case(), "ip")
    profile = solution.profile(100.0)
    assert (profile.start_m, profile.end_m) == (100.0, 1031.0)
    assert profile.duration_s == pytest.approx(78.0, abs=1e-4)
    assert profile.acceleration_mps2[:-1] == pytest.approx(solution.acceleration_mps2)


def test_energy_is_kept_between_traction_brakes_and_resistance(paper_case):
    problem = paper_case(regeneration_efficiency=0.6, braking=Efforts(60e3, 0.5e6))
    solution = solve(problem, "ip")
    resisted = np.sum(np.diff(problem.position_m) * solution.force_n)  # standstill at both ends
    assert solution.traction_j - solution.braked_j == pytest.approx(resisted)
    assert 0.0 < solution.regenerated_j < solution.braked_j
    assert solution.net_j == pytest.approx(solution.traction_j - 0.6 * solution.regenerated_j)


@pytest.mark.parametrize("length_m", [12.0, 100.0, 300.0])
@pytest.mark.parametrize("share", [1.0005, 1.1, 1.6, 3.0])
def test_a_short_hop_takes_its_time(routes, length_m, share):
    problem = routes.random_route(4, length_m=length_m, max_step_m=5.0)
    time_s = share * fastest(problem).trip_time_s
    solution = solve(problem.with_time(time_s), "ip")
    assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)


@pytest.mark.parametrize("share", [1.0005, 1.06, 1.4])
def test_a_line_of_100_km_takes_its_time(routes, share):
    problem = routes.random_route(1, length_m=100e3, max_step_m=20.0)
    time_s = share * fastest(problem).trip_time_s
    assert solve(problem.with_time(time_s), "ip").trip_time_s == pytest.approx(time_s, abs=0.01)


def _downhill(permille: float, **changes) -> Problem:
    nodes = mesh(0.0, 1500.0, [], 5.0)
    stages = len(nodes) - 1
    return Problem(
        position_m=nodes,
        speed_limit_mps=np.full(stages, 15.0),
        track_n_per_kn=np.full(stages, permille),
        mass_kg=142e3,
        effective_mass_kg=150e3,
        davis=DavisCoefficients(2444.0, 117.65, 3.33),
        max_acceleration_mps2=1.0,
        max_deceleration_mps2=1.0,
        time_s=130.0,
        **changes,
    )


@pytest.mark.parametrize("time_s", [150.0, 200.0, 400.0, 1500.0])
def test_downhill_a_train_rolls_for_nothing_and_takes_its_time(time_s):
    solution = solve(replace(_downhill(-25.0), time_s=time_s), "ip")
    assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)
    assert solution.traction_j == pytest.approx(0.0, abs=2e3)  # 0.01 % of the energy of motion
    assert np.all(solution.speed_mps <= 15.0 + 1e-9)


def test_downhill_a_regenerative_brake_gives_energy_back():
    solution = solve(_downhill(-25.0, regeneration_efficiency=0.8, traction_efficiency=0.8), "ip")
    assert solution.net_j < 0.0
    fall_j = 142e3 * 9.81 * 25e-3 * 1500.0
    assert -solution.net_j < 0.8 * fall_j


@pytest.mark.parametrize("start_mps", [2.0, 8.0, 14.0])
def test_a_profile_may_begin_on_the_move_and_more_time_never_costs_more(start_mps):
    problem = replace(_downhill(-3.0), start_speed_mps=start_mps)
    least = fastest(problem).trip_time_s
    energies = []
    for share in (1.0, 1.01, 1.1, 1.3, 1.6):
        solution = solve(problem.with_time(share * least), "ip")
        assert solution.speed_mps[0] == pytest.approx(start_mps)
        assert solution.trip_time_s == pytest.approx(share * least, abs=0.01)
        energies.append(solution.net_j)
    assert np.all(np.diff(energies) <= 1e-4 * energies[0])


def test_every_solution_says_how_it_was_found(paper_case):
    solution = solve(paper_case())
    assert solution.solver == "ip"
    assert 0 < solution.iterations < 30
    assert solution.min_time_s == pytest.approx(72.88, abs=0.01)
    assert solution.multiplier_w == pytest.approx(1079.7e3, rel=0.01)
