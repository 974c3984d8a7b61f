"""The interior point against the paper's case, IPOPT in the same run, and published energies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.problem import Efforts, Infeasible, Problem
from controller.profile.solve import energy_time_curve, fastest, solve
from hil.railway import load_line, load_train
from hil.railway.library import find_line, find_train

MJ = 1e6
KWH = 3.6e6
BRAKE = Efforts(100e3, 1.0e6)
TABLE = Efforts(None, None, ((0.0, 190e3), (10.0, 180e3), (14.0, 130e3), (22.0, 80e3)))

# Converged optimum: IPOPT and two other methods on aligned meshes of up to 16 001 nodes, MJ.
CONVERGED = {"forward": 21.701713, "reverse": 17.274008}
TIMES = (74, 75, 76, 77, 78, 79, 80, 83, 85, 90, 95, 100)
CURVE = {
    "forward": (
        34.165,
        28.426,
        24.864,
        22.851,
        21.702,
        20.683,
        19.772,
        17.533,
        16.347,
        14.102,
        12.601,
        11.547,
    ),
    "reverse": (
        34.916,
        29.834,
        26.359,
        23.872,
        22.015,
        20.655,
        19.648,
        17.274,
        16.066,
        14.459,
        13.214,
        12.211,
    ),
}


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_the_papers_case_is_at_its_converged_optimum_at_the_default_mesh(paper_case, direction):
    problem = paper_case(direction)
    solution = solve(problem, "ip")
    assert solution.traction_j / MJ == pytest.approx(CONVERGED[direction], rel=1e-3)
    assert solution.trip_time_s == pytest.approx(problem.time_s, abs=1e-4)
    assert solution.speed_mps[0] == solution.speed_mps[-1] == 0.0


@pytest.mark.parametrize("direction", ["forward", "reverse"])
def test_energy_over_time_is_the_converged_curve(paper_case, direction):
    curve = energy_time_curve(paper_case(direction, max_step_m=1.0), TIMES)
    assert [s.net_j / MJ for s in curve] == pytest.approx(CURVE[direction], rel=1e-3)
    slopes = np.diff([s.net_j for s in curve]) / np.diff(TIMES)
    for slope, before, after in zip(slopes, curve, curve[1:], strict=False):
        assert before.multiplier_w > -slope > after.multiplier_w  # -dE/dT, of a convex curve


VARIANTS = {
    "no limit of effort": {},
    "2.4 MW": {"traction": Efforts(None, 2.4e6)},
    "2.0 MW": {"traction": Efforts(None, 2.0e6)},
    "150 kN and 2 MW": {"traction": Efforts(150e3, 2.0e6)},
    "effort table": {"traction": TABLE},
    "60 % regenerated": {"regeneration_efficiency": 0.6},
    "90 % regenerated": {"regeneration_efficiency": 0.9},
    "90 % of 100 kN and 1 MW": {"regeneration_efficiency": 0.9, "braking": BRAKE},
    "no friction brake": {
        "regeneration_efficiency": 0.8,
        "traction_efficiency": 0.7,
        "traction": Efforts(180e3, 2.4e6),
        "braking": Efforts(190e3, 2.0e6),
        "pneumatic": False,
    },
    "rotating mass": {"effective_mass_kg": 155_000.0, "traction": Efforts(182e3, 2.75e6)},
    "brakes of 180 kN": {"max_braking_n": 180e3},
    "-1.2 to 1.0": {"max_deceleration_mps2": 1.2, "max_acceleration_mps2": 1.0},
    "-1.0 to 1.0": {"max_deceleration_mps2": 1.0, "max_acceleration_mps2": 1.0},
    "-1.0 to 0.9": {"max_deceleration_mps2": 1.0, "max_acceleration_mps2": 0.9},
    "from 10 m/s": {"start_speed_mps": 10.0, "time_s": 72.0},
    "to 10 m/s": {"end_speed_mps": 10.0, "time_s": 72.0},
    "90 s": {"time_s": 90.0},
}


@pytest.mark.parametrize("direction", ["forward", "reverse"])
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant_has_the_energy_that_ipopt_finds(paper_case, solve_ipopt, name, direction):
    problem = replace(paper_case(direction), **VARIANTS[name])
    solution, peer = solve(problem, "ip"), solve_ipopt(problem)
    assert peer.solved
    assert solution.net_j == pytest.approx(peer.net_j, rel=1e-3)
    assert solution.net_j <= peer.net_j * (1.0 + 3e-4)  # a smoothed effort table is a little lower
    assert solution.trip_time_s == pytest.approx(problem.time_s, abs=0.01)
    _keeps_every_limit(solution)


def test_too_wide_an_acceleration_range_is_no_help_but_too_narrow_a_one_is_infeasible(paper_case):
    problem = paper_case(max_deceleration_mps2=1.0, max_acceleration_mps2=0.8)
    with pytest.raises(Infeasible, match=r"78 s must be at least 78.9\d s") as caught:
        solve(problem)
    assert caught.value.min_time_s == pytest.approx(78.98, abs=0.02)
    assert caught.value.binding in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_longer_range_of_acceleration_never_costs_energy(paper_case):
    energies = [
        solve(paper_case(max_deceleration_mps2=low, max_acceleration_mps2=high), "ip").net_j
        for low, high in ((1.0, 0.9), (1.0, 1.0), (1.2, 1.0), (1.4, 1.1), (1.5, 1.3))
    ]
    assert energies == sorted(energies, reverse=True)


def test_a_known_solution_as_a_start_changes_nothing_but_the_number_of_iterations(paper_case):
    known = solve(paper_case(time_s=79.0), "ip")
    cold, warm = solve(paper_case(), "ip"), solve(paper_case(), "ip", start=known)
    assert warm.net_j == pytest.approx(cold.net_j, rel=1e-5)
    assert warm.iterations <= cold.iterations + 2


# Sections 1 to 3 by a direct nonlinear program with IPOPT: least time, then kWh at 1.05, 1.10 and 1.20 of it,
# with at most 1 m/s2, efficiencies of 0.70 and 0.80, and 10 m steps.
YIZHUANG = {
    1: (152.051, (24.646, 21.895, 18.603)),
    2: (83.264, (15.404, 13.690, 11.391)),
    3: (130.494, (0.502, -1.891, -4.559)),
    11: (118.419, (46.442, 44.062, 41.092)),
}


def _yizhuang(section: int, **more: float) -> Problem:
    line = load_line(find_line("CN_Songjiazhuang_Yizhuang"))
    train = load_train(find_train("CN_Beijing_Subway"))
    first, last = line.stops[section - 1].position_m, line.stops[section].position_m
    return Problem.of_line(
        line, train, first, last, 1000.0, max_acceleration_mps2=1.0, max_deceleration_mps2=1.0, **more
    )


@pytest.mark.parametrize("section", YIZHUANG)
def test_yizhuang_sections_have_the_energies_of_a_direct_program(section):
    least, energies = YIZHUANG[section]
    problem = _yizhuang(section, max_step_m=10.0)
    assert fastest(problem).trip_time_s == pytest.approx(least, abs=1e-3)
    for share, energy in zip((1.05, 1.10, 1.20), energies, strict=True):
        solution = solve(problem.with_time(share * least), "ip")
        # printed to 0.001 kWh, of which section 3 at 1.05 has but 502
        assert solution.net_j / KWH == pytest.approx(energy, rel=1e-3, abs=1e-3)
        _keeps_every_limit(solution)


@pytest.mark.parametrize("section", range(1, 14))
def test_all_sections_of_yizhuang_are_solved_at_the_default_mesh(section):
    problem = _yizhuang(section)
    least = fastest(problem).trip_time_s
    for share in (1.0, 1.0001, 1.02, 1.3):
        solution = solve(problem.with_time(share * least), "ip")
        assert solution.trip_time_s == pytest.approx(share * least, abs=0.01)
        _keeps_every_limit(solution)


def test_virm6_has_the_energy_of_gpops():
    """Kouzoupis et al. (2023), figure 10: 440.1406 kWh by GPOPS-II, from 1 m/s to 1 m/s in 1541 s.

    Their trajectory has 213.9 kN and 3129.277 kW for traction and for the motor brake, which is the only
    one, and an efficiency of 0.73 either way; the train's file has other limits.
    """
    line = load_line(find_line("00_var_speed_limit_100"))
    train = load_train(find_train("NL_Intercity_VIRM6"))
    problem = Problem.of_line(
        line, train, 0.0, 48_531.0, 1541.0, max_step_m=25.0,
        max_acceleration_mps2=1.0, max_deceleration_mps2=1.0,
        traction_efficiency=0.73, regeneration_efficiency=0.73, pneumatic=False,
        start_speed_mps=1.0, end_speed_mps=1.0,
    )  # fmt: skip
    both = Efforts(213_900.0, 3_129_277.0)
    solution = solve(replace(problem, traction=both, braking=both), "ip")
    assert solution.net_j / KWH == pytest.approx(440.1406, rel=1e-3)
    assert solution.net_j / KWH > 440.1406 * (1 - 1e-5)  # a coarser mesh is not below the optimum


def _keeps_every_limit(solution) -> None:
    """At any point, not only at nodes: between two nodes v^2 is linear in position."""
    problem = solution.problem
    position, step = problem.position_m, np.diff(problem.position_m)
    y = 0.5 * solution.speed_mps**2
    for part in np.linspace(0.0, 1.0, 9):
        v = np.sqrt(2.0 * (y[:-1] + part * np.diff(y)))
        assert np.all(v <= problem.speed_limit_mps + 1e-6)
        traction = np.maximum(solution.force_n, 0.0)
        assert np.all(traction <= problem.traction.force_n(v) * (1.0 + 1e-5) + 1.0)
        if not problem.pneumatic:
            assert np.all(-solution.force_n <= problem.braking.force_n(v) * (1.0 + 1e-5) + 1.0)
    acceleration = np.diff(y) / step
    assert acceleration == pytest.approx(solution.acceleration_mps2, abs=1e-9)
    assert np.max(acceleration) <= problem.max_acceleration_mps2 + 1e-5
    assert np.min(acceleration) >= -problem.max_deceleration_mps2 - 1e-5
    assert position[0] == 0.0
