"""Of a line is kept what drawing it needs: the line through the kept samples is within the tolerance."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.record.thinning import HELD_TOLERANCE, NOISE_SAMPLES, TOLERANCE, Thinner, kept_rows


def drawn(values, rows):
    return np.interp(np.arange(len(values)), rows, values[rows])


@settings(deadline=None)  # other jobs share the machine
@given(st.integers(0, 5000))
def test_a_straight_line_of_any_length_keeps_little(count):
    rows = kept_rows(np.arange(count) * 0.5, 1e-9)
    assert len(rows) <= 2 + count // 1024
    assert count == 0 or (rows[0] == 0 and rows[-1] == count - 1)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 400), st.floats(-50, 50)), min_size=1, max_size=20))
def test_a_smooth_line_is_drawn_within_the_tolerance(pieces):
    slopes = np.concatenate([np.full(count, slope) for count, slope in pieces])
    values = np.cumsum(np.cumsum(slopes)) * 1e-4
    tolerance = 1e-3 * max(np.ptp(values), 1e-9)
    rows = kept_rows(values, tolerance)
    error = np.abs(drawn(values, rows) - values)
    # Where the finest stretches are not straight, their extremes bound what is drawn.
    fine = np.array(
        [np.ptp(values[max(0, k - NOISE_SAMPLES) : k + NOISE_SAMPLES + 1]) for k in range(len(values))]
    )
    assert np.all((error <= tolerance * (1 + 1e-9)) | (error <= fine))


@settings(deadline=None)  # other jobs share the machine
@given(st.lists(st.integers(0, 3), min_size=3, max_size=6), st.integers(40, 2000))
def test_a_step_keeps_both_its_sides(levels, length):
    values = np.repeat(np.array(levels, float), length)
    rows = kept_rows(values, 0.0)
    np.testing.assert_array_equal(drawn(values, rows), values)


@settings(deadline=None)  # other jobs share the machine
@given(st.integers(0, 2**32 - 1))
def test_the_peaks_of_noise_survive_and_a_tenth_of_its_samples(seed):
    values = np.random.default_rng(seed).normal(size=8192)
    rows = kept_rows(values, 1e-3)
    for start in range(0, len(values) - NOISE_SAMPLES, NOISE_SAMPLES):
        window, chosen = (
            values[start : start + NOISE_SAMPLES],
            rows[(rows >= start) & (rows < start + NOISE_SAMPLES + 1)],
        )
        assert values[chosen].max() >= window.max()
        assert values[chosen].min() <= window.min()
    assert len(rows) < len(values) * 3.5 / NOISE_SAMPLES


def test_unknown_values_are_kept_at_both_ends_of_a_gap():
    values = np.concatenate((np.zeros(500), np.full(500, np.nan), np.ones(500)))
    rows = kept_rows(values, 1e-3)
    assert np.isnan(values[rows]).any()
    assert values[rows[0]] == 0
    assert values[rows[-1]] == 1


def test_the_tolerance_grows_with_the_range_and_never_shrinks():
    thinner = Thinner()
    wave = np.sin(np.arange(2048) / 50)
    alone = len(thinner.rows(wave * 1e-3))
    thinner.rows(np.array([-1.0, 1.0]))
    assert len(thinner.rows(wave * TOLERANCE / 4)) < alone


@settings(deadline=None)  # other jobs share the machine
@given(st.lists(st.floats(-50, 50), min_size=3, max_size=500))
def test_what_is_drawn_in_steps_departs_by_no_more_than_its_tolerance(slopes):
    values = np.cumsum(slopes)
    rows = Thinner(held=True).rows(values)
    held = values[rows[np.searchsorted(rows, np.arange(len(values)), side="right") - 1]]
    assert np.max(np.abs(held - values)) <= HELD_TOLERANCE * np.ptp(values) * (1 + 1e-9)


def test_a_slope_drawn_in_steps_keeps_more_than_its_ends():
    slope = np.linspace(80.0, 20.0, 1000)
    assert 190 < len(Thinner(held=True).rows(slope)) < 210
    assert len(Thinner().rows(slope)) == 2
