"""Split, signal age and command latency out of stamps, beside the plainest way to compute them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.timing.latency import chain_latency_us, period_error_us, signal_age_us, spans_us

STAMPS = st.lists(st.integers(0, 10_000), max_size=40).map(lambda v: np.array(sorted(v), np.int64))


@given(STAMPS, STAMPS)
def test_signal_age_counts_from_the_newest_frame_before_the_use(used, sent):
    expected = [(use - max(s for s in sent if s <= use)) / 1e3 for use in used if any(s <= use for s in sent)]
    assert list(signal_age_us(used, sent)) == pytest.approx(expected)


@given(STAMPS, STAMPS)
def test_command_latency_goes_to_the_first_frame_after_the_cause(causes, effects):
    expected = [
        (min(e for e in effects if e > cause) - cause) / 1e3
        for cause in causes
        if any(e > cause for e in effects)
    ]
    assert list(chain_latency_us(causes, effects)) == pytest.approx(expected)


def ring(fields, *rows):
    records = np.zeros(len(rows), [(name, "i8") for name in fields])
    for record, row in zip(records, rows, strict=True):
        for name, value in zip(fields, row, strict=True):
            record[name] = value
    return records


def test_the_split_adds_up_to_the_execution_with_any_set_of_stamps():
    for fields in (
        ("cycle", "scheduled_ns", "woke_ns", "read_ns", "stepped_ns", "sent_ns", "missed"),
        ("cycle", "scheduled_ns", "woke_ns", "read_ns", "stepped_ns", "encoded_ns", "sent_ns", "missed"),
    ):
        row = [1, 0, *(1000 * k * k for k in range(1, len(fields) - 2)), 0]
        records = ring(fields, row)
        spans = spans_us(records)
        assert sum(float(v[0]) for v in spans.values()) == (row[-2] - row[2]) / 1e3
        assert list(spans)[-1] == "send"
        assert ("encode" in spans) is ("encoded_ns" in fields)


def test_a_skipped_cycle_is_no_period_error():
    records = ring(("scheduled_ns", "woke_ns"), (0, 10), (1000, 1010), (4000, 4030))
    assert list(period_error_us(records)) == pytest.approx([0.0, 0.02])
