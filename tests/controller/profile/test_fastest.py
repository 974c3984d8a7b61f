"""The fastest profile: closed forms, the limit that binds, and what cannot be run at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from controller.profile.mesh import mesh
from controller.profile.problem import Efforts, Infeasible, Problem
from controller.profile.solve import fastest, solve
from hil.railway import DavisCoefficients


def flat(length_m: float = 1000.0, step_m: float = 5.0, **changes) -> Problem:
    """Level track, 100 t without resistance, 20 m/s, +-1 m/s2."""
    nodes = mesh(0.0, length_m, [], step_m)
    stages = len(nodes) - 1
    plain = Problem(
        position_m=nodes,
        speed_limit_mps=np.full(stages, 20.0),
        track_n_per_kn=np.zeros(stages),
        mass_kg=100e3,
        effective_mass_kg=100e3,
        davis=DavisCoefficients(0.0, 0.0, 0.0),
        max_acceleration_mps2=1.0,
        max_deceleration_mps2=1.0,
        time_s=500.0,
    )
    return replace(plain, **changes)


def test_level_track_takes_the_time_of_a_trapezoid():
    # 20 s and 200 m up, 600 m at 20 m/s, 20 s and 200 m down
    assert fastest(flat()).trip_time_s == pytest.approx(70.0, abs=1e-9)


def test_a_short_hop_takes_the_time_of_a_triangle():
    assert fastest(flat(100.0)).trip_time_s == pytest.approx(20.0, abs=1e-9)


def test_full_power_takes_the_time_of_its_closed_form():
    # from 5 to 20 m/s at constant power per mass p: t = (v1^2 - v0^2)/2p, x = (v1^3 - v0^3)/3p
    p = 4.0
    length = (20.0**3 - 5.0**3) / (3.0 * p)
    problem = flat(
        length, 0.5, start_speed_mps=5.0, end_speed_mps=20.0 - 0.2, traction=Efforts(None, p * 100e3)
    )
    assert fastest(problem).trip_time_s == pytest.approx((20.0**2 - 5.0**2) / (2.0 * p), rel=2e-3)


def test_no_profile_of_the_same_limits_is_faster_anywhere(paper_case):
    problem = paper_case(traction=Efforts(180e3, 2.4e6))
    top = fastest(problem).speed_mps
    for share in (1.001, 1.05, 1.5):
        slower = solve(problem.with_time(share * fastest(problem).trip_time_s), "ip")
        assert np.all(slower.speed_mps <= top + 1e-6)


@pytest.mark.parametrize(
    ("change", "binding"),
    [
        ({}, "speed limit"),
        ({"speed_limit_mps": np.full(200, 60.0), "max_acceleration_mps2": 0.3}, "acceleration"),
        ({"speed_limit_mps": np.full(200, 60.0), "max_deceleration_mps2": 0.3}, "deceleration"),
        ({"speed_limit_mps": np.full(200, 60.0), "traction": Efforts(20e3)}, "traction force"),
        ({"speed_limit_mps": np.full(200, 60.0), "traction": Efforts(300e3, 200e3)}, "traction power"),
        (
            {"speed_limit_mps": np.full(200, 60.0), "pneumatic": False, "braking": Efforts(20e3)},
            "braking force",
        ),
    ],
)
def test_too_short_a_time_names_the_least_one_and_what_binds(change, binding):
    problem = flat(time_s=30.0, **change)
    with pytest.raises(Infeasible) as caught:
        solve(problem)
    assert caught.value.binding == binding
    assert caught.value.min_time_s == pytest.approx(fastest(problem).trip_time_s)
    assert f"must be at least {np.ceil(caught.value.min_time_s * 100) / 100:.2f} s" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"track_n_per_kn": np.full(200, 30.0), "traction": Efforts(20e3)}, "cannot climb at 0 m"),
        ({"start_speed_mps": 19.0, "speed_limit_mps": np.full(200, 5.0)}, "must have 5.0 m/s"),
        ({"end_speed_mps": 19.0, "traction": Efforts(5e3)}, "reaches 10.0 m/s at most"),
        (
            {"track_n_per_kn": np.full(200, -30.0), "pneumatic": False, "braking": Efforts(20e3)},
            "cannot brake at",
        ),
    ],
)
def test_what_cannot_be_run_in_any_time_says_why(change, said):
    with pytest.raises(Infeasible, match=said) as caught:
        solve(flat(**change))
    assert caught.value.min_time_s == float("inf")
