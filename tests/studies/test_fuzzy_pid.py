"""The 36 km line: the plan's limits, the plant beside an adaptive solver, and what feed-forward buys."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from studies.fuzzy_pid_laws import contenders
from studies.fuzzy_pid_plant import CLIMB_M, DATA, SAMPLE_S, plan, sensitivity_peak
from studies.train_plant import TrainPlant


@pytest.fixture(scope="module")
def reference():
    return plan()


def test_the_plan_keeps_its_limits_and_ends_at_the_stop(reference):
    assert reference.position_m[-1] == pytest.approx(36_280.0, abs=1.0)
    assert reference.speed_mps[-1] == pytest.approx(0.0, abs=2e-3)
    assert np.max(reference.speed_mps) == pytest.approx(30.0, abs=0.01)
    assert np.max(reference.acceleration_mps2) <= 0.6 + 1e-9
    assert np.min(reference.acceleration_mps2) >= -0.8 - 1e-9
    assert np.max(np.abs(np.diff(reference.acceleration_mps2))) <= 0.5 * SAMPLE_S + 1e-9
    climbing = (reference.position_m > CLIMB_M[0]) & (reference.position_m < CLIMB_M[1])
    np.testing.assert_allclose(reference.speed_mps[climbing], 25.0, atol=0.01)
    needed = reference.acceleration_mps2 + DATA.davis_mps2.a_n
    assert np.max(needed * reference.speed_mps) < DATA.max_power_w_per_kg


def test_the_plan_s_position_is_the_integral_of_its_speed(reference):
    moved = np.cumsum(0.5 * SAMPLE_S * (reference.speed_mps[1:] + reference.speed_mps[:-1]))
    np.testing.assert_allclose(reference.position_m[1:], moved, atol=0.1)


def test_resistance_is_a_quarter_of_a_metre_per_second_squared_at_108_kmh():
    assert DATA.davis_mps2.resistance_n(30.0) == pytest.approx((0.0015 * 108**2 + 0.27 * 108 + 215) / 1000)


def test_the_train_agrees_with_an_adaptive_solver():
    """A command that steps every 5 s, without jerk limit: dead time, lag, power limit, resistance."""
    commands = (0.9, 0.4, -0.3, 0.6, 0.9)
    plant = TrainPlant(DATA, None, step_s=0.01)
    speeds = []
    for k in range(2500):
        speeds.append(plant.speed_mps)
        plant.advance(commands[k // 500])

    def slope(t, state):
        v, effort = state
        asked = commands[min(int((t - DATA.dead_time_s) // 5.0), 4)] if t >= DATA.dead_time_s else 0.0
        possible = min(max(asked, -DATA.max_braking_mps2), DATA.traction_mps2(v))
        moving = v > 0.0 or effort > DATA.davis_mps2.resistance_n(0.0)
        rise = effort - DATA.davis_mps2.resistance_n(v) if moving else 0.0
        return [rise, (possible - effort) / DATA.lag_s]

    at = np.arange(0.0, 25.0, 0.25)
    exact = solve_ivp(slope, (0.0, 25.0), [0.0, 0.0], t_eval=at, max_step=0.005, rtol=1e-6)
    np.testing.assert_allclose(np.array(speeds)[::25], exact.y[0], atol=0.02)


def test_feed_forward_buys_what_fuzzy_gains_do_not(fuzzy_pid_study, number):
    forward = "Tuned gains with feed-forward"
    fixed = number(fuzzy_pid_study, forward, "PID: RMS error")
    assert fixed <= 0.03
    bare = next(
        row.ours
        for row in fuzzy_pid_study.rows
        if (row.group, row.quantity) == ("Tuned gains", "PID: RMS error")
    )
    assert bare <= 0.06
    assert fixed < 0.53 * bare, "feed-forward buys 47 % at least"
    buys = "What buys what"
    assert 0.9 < number(fuzzy_pid_study, buys, "RMS error of the best fuzzy PID over fixed, no") <= 1.0
    assert 0.95 < number(fuzzy_pid_study, buys, "RMS error of the best fuzzy PID over fixed, feed") <= 1.0


def test_a_paper_without_numbers_is_not_judged(fuzzy_pid_study):
    assert all(row.paper is None and row.reproduced is None for row in fuzzy_pid_study.rows)


def test_the_sensitivity_s_peak_of_a_known_loop():
    """P control of 1/(s (0.6 s + 1)) with 0.25 s of delay, on a dense grid; and far too strong."""
    w = np.geomspace(0.01, 31.4, 20_000)
    s = 1j * w
    loop = 0.8 * np.exp(-0.25 * s) / (s * (0.6 * s + 1.0))
    expected = np.max(1.0 / np.abs(1.0 + loop))
    assert sensitivity_peak(np.array([0.8, 0.0, 0.0]), 10.0) == pytest.approx(expected, rel=0.01)
    assert sensitivity_peak(np.array([20.0, 0.0, 0.0]), 10.0) == math.inf


def test_every_fuzzy_controller_stands_on_a_fixed_one_of_the_same_gains():
    everyone = {c.name: c for c in contenders()}
    assert len(everyone) == 9
    for contender in everyone.values():
        base = everyone[contender.base]
        assert (contender.gains, contender.feed_forward) == (base.gains, base.feed_forward)
