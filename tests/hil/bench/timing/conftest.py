"""Measurements that were made up, so that what they must lead to is known."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from hil.bench.scenario import load_scenario
from hil.bench.timing.campaign import Campaign
from hil.bench.timing.host import Host
from hil.bench.timing.request import FULL, LOOP_PLAIN, LOOP_SPIN, PEER, TimingRequest
from hil.bench.timing.samples import Slice, merged
from hil.canbus.transport import BusOptions

GOOD_HOST = Host(
    kernel="Linux 6.12", cpus=4, preempt_rt=True, governors=("performance",), hypervisor=False, throttle=1.0,
    isolated="3", deepest_idle_us=2, sched_fifo=True, memory_lock=True, memory_lock_detail="",
    competitors=0.0,
)  # fmt: skip


def measured(**parts):
    """(condition, part) -> Measured of one slice each, from wake-up latencies or slices; condition idle."""
    slices = {}
    for part, given in parts.items():
        piece = given if isinstance(given, Slice) else Slice(np.asarray(given, float))
        slices["idle", part] = [piece]
    return merged(slices)


@pytest.fixture(scope="session")
def scenario():
    with tempfile.TemporaryDirectory() as scratch:
        return load_scenario("cat_linh_la_thanh", scratch=Path(scratch))


@pytest.fixture
def campaign(scenario, tmp_path):
    """4000 cycles of every part: cyclictest around 40 us, the loop with spin around 1 us."""
    random = np.random.default_rng(1)
    full = Slice(
        random.gamma(2.0, 0.5, 4000),
        spans_us={"read": np.full(4000, 30.0), "step": np.full(4000, 60.0), "send": np.full(4000, 20.0)},
        execution_us=random.normal(110.0, 5.0, 4000),
        signal_age_us=np.full(4000, 5000.0),
        command_latency_us=np.full(4000, 5100.0),
        plant_latency_us=np.full(4000, 1.0),
        period_error_us=random.normal(0.0, 1.0, 3999),
        cpu_share={"controller": 0.1},
        missed={"controller": 0, "plant_sim": 0},
        witnessed=True,
        rights={"sched_fifo": True, "spin": {"mode": "auto"}},
        series_ns=np.arange(4000) * 10_000_000,
    )
    parts = measured(
        **{
            LOOP_PLAIN: random.gamma(40.0, 1.0, 4000),
            LOOP_SPIN: random.gamma(2.0, 0.5, 4000),
            FULL: full,
            PEER: np.floor(random.gamma(40.0, 1.0, 4000)),
        }
    )
    request = TimingRequest(
        scenario=scenario, bus=BusOptions("hil", "test"), out=tmp_path, period_s=0.01, duration_s=40.0,
        slices=1, parts=(LOOP_PLAIN, LOOP_SPIN, FULL, PEER),
    )  # fmt: skip
    return Campaign(request, GOOD_HOST, None, parts, {"idle": 0.2}, {"idle": 0.0}, "")


@pytest.fixture
def make_measured():
    return measured


@pytest.fixture
def good_host():
    return GOOD_HOST
