"""Notches, efficiency maps and neutral sections: dynamic programming beside a plain lattice in numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from controller.profile.drive_map import DriveMap, EfficiencyMap
from controller.profile.problem import Infeasible, Problem
from controller.profile.profile import ProfileError
from controller.profile.solve import solve

UNEVEN = EfficiencyMap(
    speeds_mps=(0.0, 8.0, 16.0, 24.0),
    efforts_n=(0.0, 40e3, 100e3, 200e3),
    traction=((0.5, 0.6, 0.7, 0.6), (0.6, 0.8, 0.9, 0.8), (0.6, 0.85, 0.92, 0.85), (0.6, 0.8, 0.9, 0.85)),
    regeneration=((0.0, 0.0, 0.0, 0.0), (0.0, 0.4, 0.6, 0.6), (0.0, 0.6, 0.8, 0.7), (0.0, 0.6, 0.8, 0.7)),
)


def lattice_optimum(problem: Problem, multiplier_w: float, points: int = 700) -> tuple[float, float]:
    """Energy [J] and time [s] of the best way, node to node on an even lattice in v^2/2, for one multiplier.

    Written without the solver's code: every pair of neighbouring states, no interpolation, no tube.
    """
    y = np.linspace(0.0, 0.5 * float(np.max(problem.speed_limit_mps)) ** 2, points)
    v = np.sqrt(2.0 * y)
    step = np.diff(problem.position_m)
    limit = 0.5 * problem.node_limit_mps**2
    middle = 0.5 * (problem.position_m[1:] + problem.position_m[:-1])
    neutral = [any(a < m < b for a, b in problem.drive.neutral_sections_m) for m in middle]

    def stage(k: int, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States that can follow state i in stage k, and what they take in energy and time."""
        low = np.searchsorted(y, y[i] - problem.max_deceleration_mps2 * step[k] - 1e-9)
        high = np.searchsorted(y, y[i] + problem.max_acceleration_mps2 * step[k] + 1e-9, side="right")
        j = np.arange(low, high)
        j = j[(v[i] + v[j] > 0.0) & (y[j] <= limit[k + 1] + 1e-9)]
        mean = 0.5 * (v[i] + v[j])
        davis = problem.davis
        force = problem.effective_mass_kg * (y[j] - y[i]) / step[k] + davis.a_n + davis.b_n_per_mps * mean
        force += davis.c_n_per_mps2 * (y[i] + y[j]) + problem.track_n_per_kn[k] * problem.mass_kg * 9.81e-3
        return j, step[k] * line_force(problem, mean, force, neutral[k]), step[k] / mean

    ahead = np.where(y == 0.0, 0.0, np.inf)
    choice = np.zeros((len(step), points), dtype=int)
    for k in range(len(step) - 1, -1, -1):
        here = np.full(points, np.inf)
        for i in range(points) if k else (0,):
            if y[i] > limit[k] + 1e-9:
                break
            j, energy, taken = stage(k, i)
            if len(j):
                total = energy + multiplier_w * taken + ahead[j]
                here[i], choice[k, i] = np.min(total), j[np.argmin(total)]
        ahead = here
    state, energy_j, time_s = 0, 0.0, 0.0
    for k in range(len(step)):
        j, energy, taken = stage(k, state)
        at = int(np.flatnonzero(j == choice[k, state])[0])
        energy_j, time_s, state = energy_j + energy[at], time_s + taken[at], choice[k, state]
    return energy_j, time_s


def line_force(problem: Problem, speed: np.ndarray, force: np.ndarray, neutral: bool) -> np.ndarray:
    if neutral:
        return np.where(force > 400.0, np.inf, 0.0)  # the lattice cannot coast exactly
    given = problem.drive.efficiency
    if given is None:
        return np.where(
            force > 0.0, force / problem.traction_efficiency, problem.regeneration_efficiency * force
        )
    axes = given.speeds_mps, given.efforts_n
    at = np.column_stack((np.clip(speed, 0.0, axes[0][-1]), np.clip(np.abs(force), 0.0, axes[1][-1])))
    drawn, back = (
        RegularGridInterpolator(axes, np.array(table))(at) for table in (given.traction, given.regeneration)
    )
    return np.where(force > 0.0, force / drawn, force * back)


@pytest.fixture
def short_hop(paper_case) -> Problem:
    problem = paper_case("forward", 40.0, max_step_m=20.0)
    keep = problem.position_m <= 342.0
    return replace(
        problem,
        position_m=problem.position_m[keep].copy(),
        speed_limit_mps=problem.speed_limit_mps[: keep.sum() - 1].copy(),
        track_n_per_kn=problem.track_n_per_kn[: keep.sum() - 1].copy(),
        time_s=46.0,
    )


@pytest.mark.parametrize(
    "drive",
    [DriveMap(efficiency=UNEVEN), DriveMap(neutral_sections_m=((60.0, 120.0),))],
    ids=["map", "neutral"],
)
def test_no_profile_of_a_plain_lattice_is_better(short_hop, drive):
    problem = replace(short_hop, drive=drive)
    for multiplier_w in (0.3e6, 1.0e6):
        energy_j, time_s = lattice_optimum(problem, multiplier_w)
        solution = solve(problem.with_time(time_s))
        assert solution.solver == "dp"
        assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)
        # The lattice is coarse, and may draw 400 N in a neutral section: it lies a little off either way.
        assert solution.net_j == pytest.approx(energy_j, rel=3e-2)
        assert solution.net_j <= 1.004 * energy_j


def test_an_even_map_is_the_convex_problem(paper_case):
    even = EfficiencyMap((0.0, 30.0), (0.0, 200e3), ((0.8, 0.8),) * 2, ((0.5, 0.5),) * 2)
    problem = paper_case("forward", 80.0)
    convex = solve(replace(problem, traction_efficiency=0.8, regeneration_efficiency=0.5), "ip")
    assert solve(replace(problem, drive=DriveMap(efficiency=even))).net_j == pytest.approx(
        convex.net_j, rel=3e-3
    )


def test_no_traction_and_no_regeneration_in_a_neutral_section(paper_case):
    drive = DriveMap(neutral_sections_m=((340.0, 380.0),))
    problem = replace(paper_case("forward", 82.0), drive=drive, regeneration_efficiency=0.6)
    solution = solve(problem)
    inside = drive.neutral_stages(problem.position_m)
    assert inside.sum() > 3
    assert np.max(solution.force_n[inside]) <= 50.0
    assert solution.trip_time_s == pytest.approx(82.0, abs=0.01)
    assert solution.net_j > solve(replace(problem, drive=None), "ip").net_j


def test_notches_are_the_only_tractive_efforts(paper_case):
    notches = (40e3, 80e3, 120e3, 150e3)
    problem = replace(paper_case("forward", 84.0, max_step_m=2.0), drive=DriveMap(notches_n=notches))
    solution = solve(problem)
    driving = solution.force_n[solution.force_n > 50.0]
    nearest = np.min(np.abs(driving[:, None] - np.array(notches)), axis=1)
    assert np.max(nearest) < 100.0
    assert solution.trip_time_s == pytest.approx(84.0, abs=0.01)
    free = solve(replace(problem, drive=None, time_s=solution.trip_time_s), "ip")
    assert free.net_j <= solution.net_j <= 1.03 * free.net_j


def test_a_neutral_section_on_a_climb_that_stops_the_train_is_infeasible(paper_case):
    problem = paper_case("forward", 200.0)
    climb = replace(problem, track_n_per_kn=np.full(problem.stages, 40.0))
    with pytest.raises(Infeasible, match="neutral sections"):
        solve(replace(climb, drive=DriveMap(neutral_sections_m=((100.0, 800.0),))))


def test_interior_point_refuses_what_is_not_convex(short_hop):
    with pytest.raises(ProfileError, match="not convex"):
        solve(replace(short_hop, drive=DriveMap(notches_n=(1e5,))), "ip")


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: DriveMap(notches_n=(2e4, 1e4)), "ascend"),
        (lambda: DriveMap(neutral_sections_m=((50.0, 40.0),)), "before"),
        (lambda: replace(UNEVEN, traction=((0.0,) * 4,) * 4), "above 0"),
        (lambda: replace(UNEVEN, regeneration=((1.0,) * 4,) * 4), "below 1"),
        (lambda: replace(UNEVEN, speeds_mps=(0.0, 0.0, 1.0, 2.0)), "ascending"),
        (lambda: replace(UNEVEN, traction=((0.5,) * 4,) * 3), "rows"),
    ],
)
def test_values_that_contradict_are_refused(make, says):
    with pytest.raises(ProfileError, match=says):
        make()
