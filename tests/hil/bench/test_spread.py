"""Statistics over many runs: nothing that went wrong may vanish from them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.contender import Contender
from hil.bench.metrics import ControlMetrics
from hil.bench.sets import Draw
from hil.bench.spread import percentile, spread
from hil.bench.trial import TrialResult

GOOD = ControlMetrics(0.01, 0.05, -1.0, 0.0, 0.8, 0.05, 180.0, 1e8, 0.0)
PID = Contender("pid")


def result(number: int, stop_error_m: float | None, failure: str = "") -> TrialResult:
    metrics = replace(GOOD, stop_error_m=stop_error_m)
    return TrialResult(PID, Draw(number, {}), failure, metrics=metrics)


def test_a_stop_counts_whatever_its_side():
    stats = spread([result(1, 0.02), result(2, -0.07), result(3, 0.01)])
    assert (stats.stop_worst_m, stats.worst_draw) == (0.07, 2)


def test_percentiles_are_values_that_runs_had():
    stats = spread([result(k, 0.001 * k) for k in range(1, 201)])
    assert (stats.stop_p95_m, stats.stop_p99_m, stats.stop_worst_m) == pytest.approx((0.190, 0.198, 0.200))


def test_a_run_without_a_stop_is_the_worst_there_is():
    stats = spread([*(result(k, 0.01) for k in range(1, 40)), result(40, None, "not arrived within 420 s")])
    assert (stats.failed, stats.no_stop, stats.worst_draw) == (1, 1, 40)
    assert stats.stop_p95_m == 0.01
    assert math.isinf(stats.stop_p99_m)
    assert math.isinf(stats.stop_worst_m)
    assert stats.as_dict()["stop_worst_m"] is None


def test_a_failed_run_that_stopped_counts_with_where_it_stopped():
    stats = spread([result(1, 0.01), result(2, -3.2, "the train stands 3.2 m before its stop")])
    assert (stats.failed, stats.no_stop, stats.stop_worst_m) == (1, 0, 3.2)


def test_an_exception_counts_in_every_statistic():
    stats = spread([result(1, 0.01), TrialResult(PID, Draw(2, {}), "TypeError: no")])
    assert math.isinf(stats.rms_worst_mps)
    assert math.isinf(stats.jerk_worst_mps3)


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=300), st.sampled_from([50, 95, 99]))
def test_at_least_so_many_percent_do_not_exceed_a_percentile(values, percent):
    chosen = percentile(np.array(values), percent)
    assert chosen in values
    assert np.mean(np.array(values) <= chosen) * 100 >= percent - 1e-9
