"""What costs most on a host: found in facts, told in the right order, with a remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.bench.timing.advice import advice
from hil.bench.timing.host import CpuTimes, cpu_times
from hil.bench.timing.samples import Slice

STAT = """cpu  100 0 50 800 20 5 5 20 0 0
cpu0 50 0 25 400 10 3 2 10 0 0
intr 12345
"""


def told(host, parts=None, *, fifo=True, steal=0.0, **more):
    return advice(host, parts or {}, {"idle": steal}, fifo=fifo, priority=50, **more)


def test_a_well_kept_host_gets_no_advice(good_host):
    assert told(good_host) == []


def test_missing_rights_come_first_whatever_else_is_wrong(good_host):
    bad = replace(
        good_host, sched_fifo=False, memory_lock=False, preempt_rt=False, hypervisor=True, isolated="",
        governors=("powersave",), deepest_idle_us=200, competitors=9.0,
    )  # fmt: skip
    found = told(bad, fifo=False, steal=0.05)
    assert "SCHED_FIFO" in found[0].what
    assert "rtprio" in found[0].remedy
    assert "5.00 % stolen" in found[1].what
    assert len(found) >= 7
    assert all(item.remedy and item.cost for item in found)


def test_an_asked_for_sched_other_is_no_missing_right(good_host):
    (first, *_) = advice(good_host, {}, {}, fifo=False, priority=0)
    assert "--priority 0" in first.what


def test_each_fact_has_its_own_remedy(good_host):
    for change, remedy in (
        ({"governors": ("powersave",)}, "cpupower"),
        ({"deepest_idle_us": 200}, "cpu_dma_latency"),
        ({"preempt_rt": False}, "linux-image-rt"),
        ({"isolated": ""}, "isolcpus"),
        ({"memory_lock": False}, "memlock"),
    ):
        (item,) = told(replace(good_host, **change))
        assert remedy in item.remedy


@pytest.mark.parametrize(("granted", "expected"), [(True, 0), (False, 1)])
def test_deep_idle_states_cost_nothing_where_the_bench_forbids_them(
    good_host, make_measured, granted, expected
):
    parts = make_measured(full=Slice(np.ones(9), rights={"cpu_idle": granted}))
    assert len(told(replace(good_host, deepest_idle_us=200), parts)) == expected


def test_the_throttle_is_told_only_to_who_comes_near_it(good_host, make_measured):
    host = replace(good_host, throttle=0.95)
    for share, expected in ((0.1, 0), (0.6, 1)):
        parts = make_measured(full=Slice(np.ones(9), cpu_share={"controller": share, "hub": 0.01}))
        assert len(told(host, parts)) == expected


def test_another_real_time_process_is_named(good_host):
    (item,) = told(good_host, competitors=frozenset({"jackd"}))
    assert "jackd" in item.what


def test_steal_is_the_share_of_all_processor_time():
    before = cpu_times(lambda: STAT)
    assert before == CpuTimes(total=1000, busy=160, steal=20)
    after = CpuTimes(total=3000, busy=1160, steal=120)
    assert after.shares_since(before) == (0.5, 0.05)
    assert before.shares_since(before) == (0.0, 0.0)
