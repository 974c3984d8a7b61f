"""The papers' forms against transcriptions of the papers' equations, written independently in numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from controller.laws import Measurement, Reference, fsmc, fuzzy_d, fuzzy_pid, pid, smc, speedt

rng = np.random.default_rng(3)


def seen(speed, acceleration=None, resistance=0.0):
    return Measurement(0.0, speed, -math.inf, math.inf, resistance, acceleration)


def fuzzy_output(e, de, p, d, u):
    """Mamdani: min, min, max, centroid over 101 points, after the Fuzzy-D paper's Tables 1 and 2."""
    table = [[0, 0, 1, 3, 4], [0, 0, 2, 4, 5], [0, 1, 3, 5, 6], [1, 2, 4, 6, 6], [2, 3, 5, 6, 6]]

    def grades(x, peaks):
        return [np.interp(x, peaks, np.eye(len(peaks))[k]) for k in range(len(peaks))]

    def mirrored(positive):
        return np.array([*[-x for x in reversed(positive)], 0.0, *positive])

    outputs = mirrored(u)
    z = np.linspace(outputs[0], outputs[-1], 101)
    heights = np.zeros(7)
    for i, mu_de in enumerate(grades(de, mirrored(d))):
        for j, mu_e in enumerate(grades(e, mirrored(p))):
            heights[table[i][j]] = max(heights[table[i][j]], min(mu_de, mu_e))
    m = np.max([np.minimum(heights[k], np.interp(z, outputs, np.eye(7)[k])) for k in range(7)], axis=0)
    return float(np.sum(z * m) / np.sum(m))


def test_paper_pid_is_the_papers_difference_equation_in_its_own_units():
    law = pid.Pid(pid.PAPER)
    dt, integral, filtered = 0.001, 0.0, 0.0
    for k in range(500):
        e = 15.0 * math.exp(-0.004 * k)
        d = 0.524 * (4.088 * e - filtered)
        expected = 2.774 * e + integral + d
        assert law.step(Reference(0.0, 15.0, 0.0, 0.0), seen(15.0 - e), dt) == pytest.approx(
            expected, rel=1e-12
        )
        integral += 0.214 * e * dt
        filtered += d * dt


@pytest.mark.parametrize(("e", "de", "u"), [(1.3731, 0.0, 30.242963), (3.43275, -2.0507, -6.929431)])
def test_speedt_gives_the_values_of_its_membership_functions(e, de, u):
    """Values worked out outside this project, with more digits of the peaks than are printed."""
    law = speedt.SpeedT(speedt.PAPER)
    assert law.step(Reference(0.0, e, de, 0.0), seen(0.0, 0.0), 1e-3) == pytest.approx(u, rel=3e-3)


def test_paper_speedt_and_fuzzy_d_are_the_mamdani_controller_and_ten_times_it():
    plain, derivative = speedt.SpeedT(speedt.PAPER), fuzzy_d.FuzzyD(fuzzy_d.PAPER)
    for e, de in rng.uniform((-16.0, -25.0), (16.0, 25.0), (40, 2)):
        flc = fuzzy_output(e, de, (6.8655, 13.731), (1.443, 20.507), (391.20, 399.57, 541.99))
        wanted, measured = Reference(0.0, 5.0 + e, 0.3 + de, 9.0), seen(5.0, 0.3, resistance=0.0)
        assert plain.step(wanted, measured, 1e-3) == pytest.approx(flc, abs=1e-9)
        expected = 10.0 * flc + 0.05 * de
        assert derivative.step(wanted, measured, 1e-3) == pytest.approx(expected, abs=1e-8)


W = (8547.0, 64.2, 2.2452)


def davis(v):
    return W[0] + W[1] * v + W[2] * v * v


@pytest.mark.parametrize("disturbance", [0.0, 0.1])
def test_paper_smc_is_equations_16_to_21(disturbance):
    mass = math.sqrt(252_500.0 * 305_000.0)
    beta = math.sqrt(305.0 / 252.5)
    law = smc.Smc(smc.SmcParameters(**{**vars(smc.PAPER), "disturbance_mps2": disturbance}))
    for v, vd, vd_dot in rng.uniform((0, 0, -1.2), (22, 22, 1.2), (40, 3)):
        w = davis(v)
        k = beta * (0.1 + disturbance) + (beta - 1.0) * abs(vd_dot + w / mass)
        force = mass * vd_dot + w - mass * k * np.sign(v - vd)
        demand = law.step(Reference(0.0, vd, vd_dot, 99.0), seen(v, resistance=w / mass), 0.01)
        assert mass * demand + w == pytest.approx(force, rel=1e-12)


def uf(s, rate):
    """25 rules, min, centre average, as the closed form of a sum table; half ranges 0.75."""
    x, y = np.clip(2 * s / 0.75, -2, 2), np.clip(2 * rate / 0.75, -2, 2)
    i, j = min(math.floor(x), 1), min(math.floor(y), 1)
    a, b = x - i, y - j
    w = [min(1 - a, 1 - b), min(a, 1 - b), min(1 - a, b), min(a, b)]
    return (w[0] * (i + j) + (w[1] + w[2]) * (i + j + 1) + w[3] * (i + j + 2)) / (4 * sum(w))


@pytest.mark.parametrize(("unit", "factor"), [("m/s", 1.0), ("km/h", 3.6)])
def test_paper_fsmc_is_equation_34_with_a_backward_difference_that_starts_at_zero(unit, factor):
    mass, dt = 252_500.0, 0.01
    law = fsmc.Fsmc(fsmc.FsmcParameters(**{**vars(fsmc.PAPER), "s_input_unit": unit}))
    before = None
    for k in range(60):
        v, vd, vd_dot = 5.0 + 0.11 * k * dt, 5.0 + 0.002 * math.sin(0.7 * k), 0.3
        s = v - vd
        rate = 0.0 if before is None else (s - before) / dt
        before = s
        w = davis(v)
        force = mass * vd_dot + w - mass * 1.0 * uf(factor * s, rate)
        demand = law.step(Reference(0.0, vd, vd_dot, 99.0), seen(v, resistance=w / mass), dt)
        assert mass * demand + w == pytest.approx(force, rel=1e-9)


def test_fuzzy_pid_gains_are_never_negative_and_move_by_the_tables_centre_cell():
    p = fuzzy_pid.FuzzyPidParameters(kp_per_s=0.1, kp_range_per_s=5.0, tables="textbook")
    law = fuzzy_pid.FuzzyPid(p)
    law.step(Reference(0.0, 10.0, 0.0, 0.0), seen(9.0, 0.0), 0.01)
    assert law.gains[0] == 0.0  # error PB, rate Z: NM takes more than there is
    law.reset()
    law.step(Reference(0.0, 10.0, 0.0, 0.0), seen(10.0, 0.0), 0.01)
    assert law.gains == pytest.approx((0.1, p.ki_per_s2, p.kd - p.kd_range / 3.0))  # Z, Z: Z, Z, NS


def test_fuzzy_pid_with_no_range_is_a_pid_of_fixed_gains():
    p = fuzzy_pid.FuzzyPidParameters(kp_range_per_s=0.0, ki_range_per_s2=0.0, kd_range=0.0, rate_filter_s=0.0)
    law, integral = fuzzy_pid.FuzzyPid(p), 0.0
    for e, rate in rng.uniform(-0.3, 0.3, (50, 2)):
        expected = p.kp_per_s * e + integral + p.kd * rate
        assert law.step(Reference(0.0, e, rate, 0.0), seen(0.0, 0.0), 0.01) == pytest.approx(
            expected, abs=1e-12
        )
        integral += p.ki_per_s2 * e * 0.01


def test_without_feed_forward_the_resistance_behind_the_law_is_taken_back():
    for law in (pid.Pid(pid.PAPER_ON_TRAIN), speedt.SpeedT(speedt.PAPER_ON_TRAIN)):
        demand = law.step(Reference(0.0, 10.0, 0.0, 0.5), seen(10.0, resistance=0.07), 0.01)
        assert demand + 0.07 == pytest.approx(0.0, abs=1e-12)
