"""Notches to the hundredth of a second, beside every sequence of notches there is; dead brakes; maps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from controller.profile.drive_map import DriveMap, EfficiencyMap
from controller.profile.problem import Efforts, Infeasible, Problem
from controller.profile.solve import fastest, solve
from hil.railway import DavisCoefficients

NOTCHES_N = (40e3, 80e3, 120e3, 150e3)
HOLLOW = EfficiencyMap(
    speeds_mps=(0.0, 8.0, 16.0, 24.0),
    efforts_n=(0.0, 40e3, 100e3, 200e3),
    traction=((0.5, 0.6, 0.7, 0.6), (0.6, 0.8, 0.9, 0.8), (0.6, 0.85, 0.92, 0.85), (0.6, 0.8, 0.9, 0.85)),
    regeneration=((0.0,) * 4,) * 4,
)
"""Best at 100 kN: to pull at less costs more per newton, so it pays to pull and coast in turns."""


def hop(time_s: float) -> Problem:
    """Six stages of 30 m over a hump, few enough to try everything."""
    return Problem(
        position_m=np.arange(7) * 30.0,
        speed_limit_mps=np.array([11.0, 11.0, 11.0, 9.0, 9.0, 11.0]),
        track_n_per_kn=np.array([0.0, 6.0, 6.0, -8.0, -8.0, 0.0]),
        mass_kg=142_360.0,
        effective_mass_kg=150_000.0,
        davis=DavisCoefficients(2444.0, 117.0, 3.33),
        max_acceleration_mps2=1.1,
        max_deceleration_mps2=1.4,
        drive=DriveMap(notches_n=(50e3, 100e3, 140e3)),
        time_s=time_s,
    )


def every_way(problem: Problem, brakes: int) -> tuple[np.ndarray, np.ndarray]:
    """Trip time [s] and traction work [J] of all sequences of notches, coasting and `brakes` decelerations.

    Written from the equations, without the solver's code. The last stage brakes to a stop from what there is.
    """
    davis, mass = problem.davis, problem.effective_mass_kg
    steps, top = np.diff(problem.position_m), 0.5 * problem.node_limit_mps**2
    y, time_s, work_j = np.zeros(1), np.zeros(1), np.zeros(1)

    def resistance(k, y0, y1):
        mean = 0.5 * (np.sqrt(2.0 * y0) + np.sqrt(2.0 * y1))
        track = problem.track_n_per_kn[k] * problem.mass_kg * 9.81e-3
        return davis.a_n + davis.b_n_per_mps * mean + davis.c_n_per_mps2 * (y0 + y1) + track

    for k, step in enumerate(steps):
        ends, forces = [], []
        if k < len(steps) - 1:
            for force in (0.0, *problem.drive.notches_n):
                y1 = y.copy()
                for _ in range(60):
                    y1 = np.maximum(y + step * (force - resistance(k, y, y1)) / mass, 0.0)
                ends.append(y1)
                forces.append(np.full_like(y, force))
            coast = ends[0]
            hardest = np.maximum(y - problem.max_deceleration_mps2 * step, 0.0)
            for share in np.linspace(0.0, 1.0, brakes, endpoint=False):
                ends.append(hardest + share * (coast - hardest))
                forces.append(np.zeros_like(y))
        else:
            ends.append(np.zeros_like(y))
            forces.append(np.zeros_like(y))
        y0 = np.tile(y, len(ends))
        y1, force = np.concatenate(ends), np.concatenate(forces)
        time0, work0 = np.tile(time_s, len(ends)), np.tile(work_j, len(ends))
        acceleration = (y1 - y0) / step
        keeps = (y1 <= top[k + 1] + 1e-9) & (y0 + y1 > 0.0) & ((y1 > 0.0) | (k == len(steps) - 1))
        keeps &= acceleration <= problem.max_acceleration_mps2 + 1e-9
        keeps &= acceleration >= -problem.max_deceleration_mps2 - 1e-9
        # a brake brakes: where the train would stop by itself sooner, there is no way
        keeps &= (force > 0.0) | (mass * acceleration + resistance(k, y0, y1) <= 1e-3)
        y0, y1, force = y0[keeps], y1[keeps], force[keeps]
        time_s = time0[keeps] + 2.0 * step / (np.sqrt(2.0 * y0) + np.sqrt(2.0 * y1))
        work_j, y = work0[keeps] + step * force, y1
    return time_s, work_j


def test_no_sequence_of_notches_is_better():
    times, works = every_way(hop(60.0), brakes=9)
    assert len(times) > 10_000  # else there would be little to beat
    for time_s in (29.0, 30.0, 31.0, 32.0, 34.0, 36.0, 38.0, 42.0):
        solution = solve(hop(time_s))
        assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)
        driving = solution.force_n[solution.force_n > 1.0]
        assert np.max(np.min(np.abs(driving[:, None] - np.array([50e3, 100e3, 140e3])), axis=1)) < 0.01
        # one that is quicker than wanted has time to brake a little more, which costs nothing
        assert solution.traction_j <= 1.001 * np.min(works[times <= time_s])
        # other brakes than those tried may save, but not more than two seconds more would
        assert solution.traction_j >= 0.999 * np.min(works[times <= time_s + 2.0])


def test_least_time_with_notches_is_that_of_the_quickest_sequence():
    times, _ = every_way(hop(60.0), brakes=9)
    with pytest.raises(Infeasible, match="notches") as caught:
        solve(hop(np.min(times) - 0.5))
    # brakes in between those tried are a little quicker
    assert np.min(times) - 0.3 <= caught.value.min_time_s <= np.min(times) + 0.05


@pytest.mark.parametrize("step_m", [5.0, 2.0])
def test_notches_meet_the_time_to_a_hundredth_of_a_second(paper_case, step_m):
    for time_s in (79.0, 84.0, 90.0, 100.0):
        problem = paper_case("forward", time_s, max_step_m=step_m)
        solution = solve(replace(problem, drive=DriveMap(notches_n=NOTCHES_N)))
        assert solution.trip_time_s == pytest.approx(time_s, abs=0.01)
        driving = solution.force_n[solution.force_n > 1.0]
        assert np.max(np.min(np.abs(driving[:, None] - np.array(NOTCHES_N)), axis=1)) < 0.01
        assert np.all(solution.speed_mps <= problem.node_limit_mps + 1e-9)
        assert np.min(solution.acceleration_mps2) >= -1.4 - 1e-6
        # what has fewer efforts to choose from cannot be cheaper
        assert solve(problem, "ip").net_j <= solution.net_j <= 1.035 * solve(problem, "ip").net_j


def test_what_notches_cost_shrinks_with_their_spacing(paper_case):
    problem = paper_case("forward", 84.0)
    free = solve(problem, "ip").net_j
    costs = []
    for spacing_n in (20e3, 5e3):
        notches = tuple(np.arange(spacing_n, 200e3 + 1.0, spacing_n))
        costs.append(solve(replace(problem, drive=DriveMap(notches_n=notches))).net_j / free - 1.0)
    # 2.6 and 0.6 % by the dual of a grid of 401 speeds: full acceleration lies between two notches
    assert 0.0 < costs[1] < 0.5 * costs[0]
    assert costs[1] < 0.008


def test_a_brake_that_only_regenerates_is_dead_in_a_neutral_section(paper_case):
    # the section lies where the train brakes for a curve; in a hurry it would brake within
    drive = DriveMap(neutral_sections_m=((155.0, 175.0),))
    problem = paper_case("forward", 73.0, braking=Efforts(180e3), regeneration_efficiency=0.5)
    problem = replace(problem, pneumatic=False)
    free = solve(problem.with_time(fastest(problem).trip_time_s))
    inside = drive.neutral_stages(problem.position_m)
    assert np.min(free.force_n[inside]) < -100e3
    with pytest.raises(Infeasible, match="neutral sections") as caught:
        solve(replace(problem, drive=drive, time_s=free.trip_time_s))
    assert caught.value.min_time_s > free.trip_time_s + 0.1
    solution = solve(replace(problem, drive=drive, time_s=caught.value.min_time_s + 0.3))
    assert np.max(np.abs(solution.force_n[inside])) <= 1.0
    assert solution.trip_time_s == pytest.approx(caught.value.min_time_s + 0.3, abs=0.01)


def test_a_friction_brake_works_in_a_neutral_section_but_gives_nothing_back(paper_case):
    drive = DriveMap(neutral_sections_m=((860.0, 925.0),))
    problem = replace(paper_case("forward", 80.0, regeneration_efficiency=0.6), drive=drive)
    solution = solve(problem)
    inside = drive.neutral_stages(problem.position_m)
    assert np.min(solution.force_n[inside]) < -100e3
    outside = ~inside & (solution.force_n < 0.0)
    work_j = float(np.sum(np.diff(problem.position_m)[outside] * -solution.force_n[outside]))
    assert solution.regenerated_j == pytest.approx(work_j, rel=1e-6)


def test_an_efficiency_map_costs_no_more_on_a_finer_mesh_or_with_more_time(paper_case):
    energies = {}
    for step_m in (5.0, 2.5):
        for time_s in (78.0, 82.0, 90.0, 100.0):
            problem = paper_case("forward", time_s, max_step_m=step_m)
            energies[step_m, time_s] = solve(replace(problem, drive=DriveMap(efficiency=HOLLOW))).net_j
    for time_s in (78.0, 82.0, 90.0, 100.0):
        assert energies[2.5, time_s] <= 1.001 * energies[5.0, time_s]
    for earlier, later in pairwise((78.0, 82.0, 90.0, 100.0)):
        assert energies[5.0, later] < energies[5.0, earlier]


def test_a_map_that_is_best_at_one_effort_is_driven_there(paper_case):
    problem = replace(paper_case("forward", 84.0), drive=DriveMap(efficiency=HOLLOW))
    solution = solve(problem)
    work = np.diff(problem.position_m) * np.maximum(solution.force_n, 0.0)
    near = np.abs(solution.force_n - 100e3) < 15e3
    assert np.sum(work[near]) > 0.5 * np.sum(work)
    # and costs less than the profile of the mean efficiency, driven through the same map
    even = solve(replace(problem, drive=None), "ip")
    mean = 0.5 * (even.speed_mps[1:] + even.speed_mps[:-1])
    pull = np.maximum(even.force_n, 0.0)
    drawn = HOLLOW.line_force_n(mean, pull, np.zeros_like(pull))
    assert solution.net_j < 0.99 * float(np.sum(np.diff(problem.position_m) * drawn))
