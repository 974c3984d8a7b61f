"""Percentiles, histograms and ratios of what was measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.timing.samples import Slice, from_histogram, histogram, merged, ratio, spread

LATENCIES = st.lists(st.integers(0, 3000), min_size=1, max_size=400)


@given(LATENCIES)
def test_a_percentile_is_the_smallest_value_that_so_many_do_not_exceed(values):
    whole = spread(np.array(values, float))
    for percentile, share in ((whole.p50, 0.5), (whole.p99, 0.99), (whole.p999, 0.999)):
        assert percentile in values
        assert sum(v <= percentile for v in values) >= share * len(values) - 1e-9
        assert sum(v < percentile for v in values) < share * len(values) + 1e-9


@given(LATENCIES)
def test_a_histogram_and_back_is_the_same_distribution(values):
    again = from_histogram(histogram(np.array(values, float)))
    assert sorted(again) == sorted(values)


def test_latency_in_a_histogram_is_rounded_down_as_cyclictest_does():
    assert histogram(np.array([0.2, 0.99, 1.0, 7.5])) == {0: 2, 1: 1, 7: 1}


def test_what_overflowed_counts_as_the_maximum():
    values = from_histogram({10: 3}, overflows=2, maximum_us=99_999.0)
    assert list(values) == [10, 10, 10, 99_999, 99_999]


def test_percentiles_of_a_known_distribution():
    whole = spread(np.arange(1.0, 1001.0))
    assert (whole.p50, whole.p99, whole.p999, whole.max, whole.count) == (500, 990, 999, 1000, 1000)


def test_nothing_measured_has_no_percentiles_and_no_ratio():
    assert spread(np.empty(0)) is None
    assert ratio(None, spread(np.ones(3)), "p99") is None
    assert ratio(spread(np.ones(3)), spread(np.zeros(3)), "p99") is None


def test_a_ratio_is_ours_over_the_peer():
    assert ratio(spread(np.full(10, 3.0)), spread(np.full(10, 60.0)), "p99") == pytest.approx(0.05)


def test_slices_together_keep_every_cycle_and_add_up_misses():
    pieces = [
        Slice(np.array([1.0, 2.0]), missed={"controller": 1}, cpu_share={"controller": 0.1}, witnessed=True),
        Slice(np.array([3.0]), missed={"controller": 2}, cpu_share={"controller": 0.3}, witnessed=False),
    ]
    known = merged({("idle", "full"): pieces})["idle", "full"]
    assert list(known.wakeup_latency_us) == [1.0, 2.0, 3.0]
    assert known.missed() == {"controller": 3}
    assert known.cpu_share() == pytest.approx({"controller": 0.2})
    assert known.unseen is None, "one slice had no witness"
