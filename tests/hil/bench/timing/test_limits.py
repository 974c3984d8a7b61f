"""Limits files, and measurements judged by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.bench.timing.limits import TimingLimits, judge, load_limits, verdict
from hil.bench.timing.misses import Miss
from hil.bench.timing.request import FULL, FULL_ALONE
from hil.bench.timing.samples import Slice, merged
from hil.railway.errors import RailwayDataError

ENOUGH = 4000


def limits(**tables):
    return TimingLimits.model_validate({"schema": 1, **tables})


def full(**fields):
    return replace(
        Slice(np.ones(ENOUGH), execution_us=np.full(ENOUGH, 100.0), rights={"sched_fifo": True}), **fields
    )


def test_the_shipped_limits_are_those_of_the_documentation():
    shipped = load_limits()
    assert shipped.ratio_to_cyclictest.plain_p99 == 1.5
    assert shipped.ratio_to_cyclictest.spin_p99 == 0.25
    assert shipped.execution_us.p99 == 400.0
    assert shipped.deadlines.unseen == 0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("schema = 1\n[execution_us]\np95 = 3.0\n", r"execution_us\.p95"),
        ("schema = 1\n[execution_us]\np50 = -1.0\n", r"execution_us\.p50"),
        ("schema = 2\n", "schema"),
        ("[execution_us]\np50 = 1.0\n", "schema"),
    ],
)
def test_a_limits_file_with_a_mistake_is_refused_with_its_key(tmp_path, text, complaint):
    file = tmp_path / "limits.toml"
    file.write_text(text)
    with pytest.raises(RailwayDataError, match=complaint) as caught:
        load_limits(file)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("ours", "passed"), [(59.0, True), (60.0, True), (61.0, False)])
def test_a_ratio_passes_up_to_its_limit(make_measured, ours, passed):
    parts = make_measured(loop_plain=np.full(ENOUGH, ours), cyclictest=np.full(ENOUGH, 40.0))
    (row,) = judge(limits(ratio_to_cyclictest={"plain_p99": 1.5}), parts)
    assert row.passed is passed
    assert row.value == pytest.approx(ours / 40.0)


def test_without_cyclictest_a_ratio_is_not_judged_and_says_so(make_measured):
    (row,) = judge(limits(ratio_to_cyclictest={"plain_p99": 1.5}), make_measured(loop_plain=np.ones(ENOUGH)))
    assert row.passed is None
    assert "cyclictest" in row.why
    assert verdict([row]) == "not judged"


def test_a_percentile_of_too_few_cycles_is_not_judged(make_measured):
    parts = make_measured(loop_spin=np.full(2999, 99.0), cyclictest=np.full(ENOUGH, 1.0))
    p99, p999 = judge(limits(ratio_to_cyclictest={"spin_p99": 1.0, "spin_p999": 1.0}), parts)
    assert p99.passed is False
    assert p999.passed is None
    assert "2999" in p999.why


def test_execution_is_judged_by_each_percentile(make_measured):
    rows = judge(limits(execution_us={"p50": 150.0, "p99": 99.0}), make_measured(full=full()))
    assert [(row.value, row.passed) for row in rows] == [(100.0, True), (100.0, False)]
    assert verdict(rows) == "failed"


def test_the_limit_of_sleep_and_spin_is_not_for_a_node_that_does_not_spin(make_measured):
    parts = make_measured(
        full=full(rights={"spin": {"mode": "off"}}), cyclictest=np.full(ENOUGH, 1.0), loop_plain=[1.0]
    )
    (row,) = judge(limits(ratio_to_cyclictest={"full_p99": 0.25}), parts)
    assert row.passed is None
    assert "spin" in row.why


MISS = Miss("controller", 7, 2, 0, 3_000_000, 2_000_000)


@pytest.mark.parametrize(
    ("stall_ns", "unseen"), [(None, None), (0, 2), (900_000, 2), (1_000_000, 0), (9_000_000, 0)]
)
def test_only_misses_without_a_stall_of_the_witness_count_as_unseen(make_measured, stall_ns, unseen):
    piece = full(misses=[replace(MISS, stall_ns=stall_ns)], witnessed=stall_ns is not None)
    (row,) = judge(limits(deadlines={"unseen": 0}), make_measured(full=piece))
    assert row.value == unseen
    assert row.passed is (None if unseen is None else unseen == 0)


@pytest.mark.parametrize(
    ("with_us", "without_us", "passed"),
    [(105.0, 100.0, True), (115.0, 100.0, False), (1.9, 1.0, True), (4.0, 1.0, False)],
)
def test_the_recorder_may_cost_a_share_or_less_than_an_allowance(make_measured, with_us, without_us, passed):
    parts = make_measured(
        full=full(wakeup_latency_us=np.full(ENOUGH, with_us)),
        full_without_recorder=full(wakeup_latency_us=np.full(ENOUGH, without_us)),
    )
    (row,) = judge(limits(recorder={"p99_ratio": 1.1, "allowance_us": 2.0}), parts)
    assert row.passed is passed


def test_one_bad_slice_is_not_put_down_to_the_recorder():
    good, bad = np.full(ENOUGH, 1.0), np.full(ENOUGH, 30.0)
    slices = {part: [full(wakeup_latency_us=good)] * 5 for part in (FULL, FULL_ALONE)}
    slices[FULL] = [*slices[FULL][:4], full(wakeup_latency_us=bad)]
    asked = limits(recorder={"p99_ratio": 1.1, "allowance_us": 2.0})
    (row,) = judge(asked, merged({("idle", part): pieces for part, pieces in slices.items()}))
    assert (row.value, row.passed) == (1.0, True)
    slices[FULL] = [full(wakeup_latency_us=bad)] * 3 + [full(wakeup_latency_us=good)] * 2
    (row,) = judge(asked, merged({("idle", part): pieces for part, pieces in slices.items()}))
    assert (row.value, row.passed) == (30.0, False)
