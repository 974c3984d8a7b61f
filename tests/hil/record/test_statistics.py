"""Histograms, percentiles and bus figures say what the plain definition says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.frame import Frame
from hil.record.blocks import decode_block
from hil.record.statistics import BusStatistics, Histogram, percentile_table

MS = 1_000_000


@given(st.lists(st.floats(0, 40_000), min_size=1, max_size=300), st.sampled_from([50.0, 99.0, 99.9, 100.0]))
def test_a_percentile_is_right_to_one_bin(values, percent):
    histogram = Histogram()
    half = len(values) // 2
    histogram.add(np.array(values[:half]))
    histogram.add(np.array(values[half:]))
    exact = np.percentile(values, percent, method="inverted_cdf")
    assert exact - 1e-6 <= histogram.percentile(percent) <= exact + 1.0


def test_the_maximum_is_kept_beyond_the_last_bin():
    histogram = Histogram()
    histogram.add(np.array([10.0, 1e6]))
    assert histogram.maximum == 1e6
    assert histogram.percentile(100) <= 1e6
    assert histogram.counts.sum() == 2


def test_the_bars_hold_every_count():
    histogram = Histogram()
    histogram.add(np.array([0.5] * 9 + [100.2] * 99))
    heights = histogram.bars(10, 11)
    assert heights[0] == pytest.approx(np.log10(1 + 9))
    assert heights[10] == pytest.approx(np.log10(1 + 99))
    assert np.count_nonzero(heights) == 2


def test_the_last_bar_holds_what_is_longer():
    histogram = Histogram()
    histogram.add(np.array([5.0, 95.0, 300.0, 1e9]))
    assert histogram.bars(10, 10)[-1] == pytest.approx(np.log10(1 + 3))


def test_the_table_has_a_row_for_each_histogram():
    histogram = Histogram()
    histogram.add(np.full(100, 41.5))
    lines = percentile_table({"controller: latency": histogram, "empty": Histogram()}).splitlines()
    assert lines[2] == "| controller: latency | 42 | 42 | 42 | 42 | 100 |"
    assert len(lines) == 4


def figures(contract, sent):
    statistics = BusStatistics(contract)
    frames = [Frame(at * MS, contract.message(name).can_id, data) for at, name, data in sent]
    block = decode_block(frames, contract)
    statistics.count(block, block.stamps_ns)
    return statistics


def motion(counter):
    return bytes([0, counter, 0, 0, 0, 0, 0, 0])


def test_gaps_in_the_counter_are_lost_frames_and_standstills_repeated_ones(contract):
    counters = [13, 14, 0, 0, 1, 5, 6]
    sent = [(10 * k, "ODO_Motion", motion(c)) for k, c in enumerate(counters)]
    heard = figures(contract, sent).heard["ODO_Motion"]
    assert (heard.lost, heard.repeated, heard.frames) == (3, 1, 7)


def test_a_row_comes_once_a_second_with_rates_and_longest_interval(contract):
    sent = [(10 * k, "ODO_Motion", motion(k % 15)) for k in range(50)]
    sent += [(10 * k + 5, "ODO_Motion", motion((k + 5) % 15)) for k in range(52, 102)]
    statistics = figures(contract, sent)
    assert statistics.row(999 * MS) is None
    row = statistics.row(1000 * MS)
    assert row["frames_per_second"] == {"ODO_Motion": pytest.approx(100.0)}
    assert row["longest_interval"] == {"ODO_Motion": pytest.approx(350.0)}  # 490 -> 525 ms, cycle 10 ms
    assert set(row["counter_errors"]) == {"ODO_Motion"}
    assert statistics.row(1500 * MS) is None
