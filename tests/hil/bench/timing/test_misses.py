"""Missed deadlines out of timing rings, and stalls that explain them."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.timing.misses import Stall, attributed, missed_deadlines

MS = 1_000_000
FIELDS = ["cycle", "scheduled_ns", "woke_ns", "read_ns", "stepped_ns", "sent_ns", "missed"]


def cycles(*rows):
    """Records of (cycle, scheduled ms, sent ms, missed)."""
    records = np.zeros(len(rows), [(name, "i8") for name in FIELDS])
    for record, (cycle, scheduled, sent, missed) in zip(records, rows, strict=True):
        record["cycle"], record["missed"] = cycle, missed
        record["scheduled_ns"], record["sent_ns"] = round(scheduled * MS), round(sent * MS)
    return records


QUIET = [(k, k, k + 0.2, 0) for k in range(10)]


def test_no_miss_without_a_skipped_cycle():
    assert missed_deadlines("controller", cycles(*QUIET), MS) == []


def test_a_miss_belongs_to_the_cycle_whose_work_ended_too_late():
    rows = [*QUIET, (10, 10, 13.5, 0), (11, 14, 14.2, 3)]
    (miss,) = missed_deadlines("controller", cycles(*rows), MS)
    assert (miss.cycle, miss.missed, miss.node) == (10, 3, "controller")
    assert (miss.from_ns, miss.until_ns) == (10 * MS, 14 * MS)
    assert miss.lost_ns == pytest.approx(3.3 * MS)


def test_a_stall_after_sending_is_lost_time_too():
    rows = [*QUIET, (10, 10, 10.2, 0), (11, 13, 13.2, 2)]
    (miss,) = missed_deadlines("controller", cycles(*rows), MS)
    assert miss.lost_ns == pytest.approx(1.8 * MS)


def test_the_first_record_says_nothing_about_what_was_before_it():
    assert missed_deadlines("controller", cycles((0, 0, 0.2, 5), *QUIET[1:]), MS) == []


def miss_of(lost_ms, at_ms=10.0):
    rows = [*QUIET, (10, at_ms, at_ms + 0.2 + lost_ms, 0), (11, at_ms + 4, at_ms + 4.2, int(lost_ms))]
    return missed_deadlines("controller", cycles(*rows), MS)


@pytest.mark.parametrize(
    ("start_ms", "end_ms", "seen"),
    [
        (10.1, 13.0, True),  # the same stall
        (9.0, 12.0, True),  # it had begun before
        (13.0, 13.2, False),  # too short to be the reason
        (4.0, 9.9, False),  # over before
        (14.5, 19.0, False),  # came after
    ],
)
def test_a_stall_explains_a_miss_if_it_overlaps_and_is_long_enough(start_ms, end_ms, seen):
    (miss,) = attributed(miss_of(3.0), [Stall(1, round(start_ms * MS), round(end_ms * MS))])
    assert miss.seen is seen


def test_the_witness_is_blind_for_one_of_its_periods():
    lost = miss_of(3.0)[0].lost_ns
    stall = Stall(0, 11 * MS, 11 * MS + lost * 45 // 100)
    assert not attributed(miss_of(3.0), [stall])[0].seen
    assert attributed(miss_of(3.0), [stall], blind_ns=lost // 4)[0].seen


def test_without_any_stall_a_miss_is_unseen():
    (miss,) = attributed(miss_of(3.0), [], blind_ns=10 * MS)
    assert miss.stall_ns == 0
    assert not miss.seen


def test_a_long_stall_hidden_behind_many_short_ones_is_found():
    short = [Stall(0, k * MS // 10, k * MS // 10 + 60_000) for k in range(300)]
    (miss,) = attributed(miss_of(3.0), [*short, Stall(1, 9 * MS, 40 * MS)])
    assert miss.seen
    assert miss.stall_ns == 31 * MS


def stall_of(start_ms, end_ms, cpu=0):
    return Stall(cpu, round(start_ms * MS), round(end_ms * MS))


def test_several_stalls_on_one_cpu_explain_a_miss_that_none_of_them_would():
    (miss,) = attributed(miss_of(3.0), [stall_of(10.0, 10.9), stall_of(11.2, 12.1)])
    assert miss.stall_ns == pytest.approx(1.8 * MS)
    assert miss.seen


def test_stalls_of_different_cpus_are_not_added_up():
    (miss,) = attributed(miss_of(3.0), [stall_of(10.0, 10.9), stall_of(11.2, 12.1, cpu=1)])
    assert miss.stall_ns == pytest.approx(0.9 * MS)
    assert not miss.seen


def test_time_in_two_overlapping_stalls_counts_once():
    (miss,) = attributed(miss_of(3.0), [stall_of(10.0, 11.0), stall_of(10.5, 11.2)])
    assert miss.stall_ns == pytest.approx(1.2 * MS)
