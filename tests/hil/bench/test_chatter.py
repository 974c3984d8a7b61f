"""Chattering measures on signals whose answer is known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.chatter import (
    chatter,
    commanded_force_n,
    ideal_force_n,
    reversals,
    ripple,
    total_variation,
)

STEP_S = 0.01
TIME_S = np.arange(0.0, 40.0, STEP_S)


def sine(amplitude, frequency_hz):
    return amplitude * np.sin(2 * np.pi * frequency_hz * TIME_S)


def test_a_command_that_is_the_ideal_one_does_not_chatter():
    ideal = sine(50e3, 0.05)
    result = chatter(TIME_S, ideal, ideal)
    assert result.excess_variation_n_per_s == 0.0
    assert result.ripple_n < 1.0  # its 0.05 Hz is two decades below the filter
    assert result.reversals_per_s == result.ideal_reversals_per_s


@pytest.mark.parametrize(("amplitude", "frequency_hz"), [(1000.0, 1.0), (400.0, 7.0)])
def test_excess_variation_of_a_sine_on_top_is_four_amplitudes_a_period(amplitude, frequency_hz):
    result = chatter(TIME_S, sine(amplitude, frequency_hz), np.zeros_like(TIME_S))
    assert result.excess_variation_n_per_s == pytest.approx(4 * amplitude * frequency_hz, rel=0.01)


def test_ripple_of_a_fast_sine_is_its_effective_value():
    assert ripple(sine(300.0, 25.0), STEP_S) == pytest.approx(300.0 / np.sqrt(2), rel=0.01)


def test_ripple_at_the_cut_off_is_half_in_amplitude():
    """Run forward and backward, the filter's 1/sqrt(2) at the cut-off becomes 1/2."""
    assert ripple(sine(300.0, 5.0), STEP_S) == pytest.approx(150.0 / np.sqrt(2), rel=0.02)


def test_ripple_of_a_slow_sine_or_a_constant_is_nothing():
    assert ripple(sine(1000.0, 0.5), STEP_S) < 0.1
    assert ripple(np.full(len(TIME_S), 7e4), STEP_S) == pytest.approx(0.0, abs=1e-6)


def test_ripple_is_unknown_where_samples_cannot_hold_it():
    assert ripple(np.arange(100.0), 0.1) is None
    assert ripple(np.arange(10.0), 0.01) is None


def test_a_square_wave_turns_twice_a_period():
    wave = np.where(np.floor(TIME_S) % 2 == 0, 1500.0, -1500.0)  # period 2 s, 40 s: 39 edges
    assert reversals(wave) == 38  # the first edge is the first movement


def test_turning_points_smaller_than_the_travel_are_not_counted():
    assert reversals(sine(990.0, 1.0)) == 0
    assert reversals(sine(1010.0, 1.0)) == pytest.approx(80, abs=2)


def test_the_first_seconds_do_not_count():
    command = np.where(TIME_S < 2.9, sine(50e3, 8.0), 0.0)
    result = chatter(TIME_S, command, np.zeros_like(command))
    assert (result.excess_variation_n_per_s, result.reversals_per_s) == (0.0, 0.0)


def test_too_short_a_run_gives_no_numbers():
    short = TIME_S[:350]
    assert chatter(short, short, short).ripple_n is None
    assert chatter(short[:0], short[:0], short[:0]).reversals_per_s is None


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=60), st.floats(-1e5, 1e5))
def test_measures_ignore_a_constant_and_the_sign(values, offset):
    values = np.array(values)
    assert reversals(-values) == reversals(values)
    assert total_variation(values + offset) == pytest.approx(total_variation(values), abs=1e-6 * 6e7)
    assert reversals(values) <= len(values)


def test_ideal_force_is_newton_with_everything_that_resists():
    force = ideal_force_n(np.array([1.0, 0.0, -0.5]), np.array([5e3, 6e3, -1e3]), 172_800.0)
    assert force.tolist() == [177_800.0, 6_000.0, -87_400.0]


def test_commanded_force_is_a_share_of_what_there_is():
    force = commanded_force_n(
        np.array([0.5, 1.0, -0.5]), np.array([0.0, 20.0, 20.0]), lambda v: 180e3 if v < 10 else 76e3, 224e3
    )
    assert force.tolist() == [90e3, 76e3, -112e3]
