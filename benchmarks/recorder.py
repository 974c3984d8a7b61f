"""What the recorder costs the control loop: the whole bench with it and without it, in turns."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from benchmarks.rows import Row
from hil.bench.scenario import load_scenario
from hil.bench.timing.campaign import measure as measure_campaign
from hil.bench.timing.request import FULL, FULL_ALONE, TimingRequest
from hil.bench.timing.samples import Measured, Spread, median_of_slices, spread
from hil.canbus.contract import Contract
from hil.canbus.options import BusOptions

DURATION_S = {0.01: 60.0, 0.001: 24.0}
"""Of each way, by period."""
SLICES = 12
"""What a hypervisor does once a minute spoils one or two slices of either way, by chance: the median slice
says what the recorder does."""
IS = "the same without recorder"

Values = Callable[[Measured], Spread | None]

QUANTITIES: dict[str, Values] = {
    "wake-up latency": lambda known: spread(known.wakeup_latency_us),
    "execution": lambda known: spread(known.values("execution_us")),
}


def measure() -> list[Row]:
    return [row for period_s in DURATION_S for row in _of_period(period_s)]


def _of_period(period_s: float) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        periods = [f"{node}.period_s={period_s!r}" for node in ("controller", "plant")]
        scenario = load_scenario("cat_linh_la_thanh", periods, scratch=Path(folder))
        request = TimingRequest(
            scenario=scenario,
            bus=BusOptions("hil", f"bench-{os.getpid()}"),
            out=Path(folder),
            period_s=period_s,
            duration_s=DURATION_S[period_s],
            slices=SLICES,
            parts=(FULL, FULL_ALONE),
            witness=False,
        )
        found = measure_campaign(
            request, Contract.load(None), show=lambda done_s, what: None, interrupted=lambda: False
        ).measured
    rows = []
    medians = [
        median_of_slices(found["idle", part], "wakeup_latency_us", "p99") for part in (FULL, FULL_ALONE)
    ]
    if medians[0] is None or medians[1] is None:
        raise RuntimeError("wake-up latency: no cycle was measured")
    what = f"wake-up latency p99 of the median slice of {SLICES}, {period_s * 1e3:g} ms, with recorder"
    rows.append(Row(what, medians[0], medians[1], "us", IS))
    for name, of in QUANTITIES.items():
        with_it, without = (of(found["idle", part]) for part in (FULL, FULL_ALONE))
        if with_it is None or without is None:
            raise RuntimeError(f"{name}: no cycle was measured")
        for label in ("p50", "p99", "p999"):
            percentile = label.replace("999", "99.9")
            what = f"{name} {percentile} of the controller, {period_s * 1e3:g} ms, with recorder"
            rows.append(Row(what, getattr(with_it, label), getattr(without, label), "us", IS))
    return rows
