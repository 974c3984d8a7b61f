"""Wake-up latency of the bench's loop at SCHED_FIFO, in slices that alternate with cyclictest on one CPU."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.rows import Row

PRIORITY = 80
SLICES = 6
CYCLES = {10_000_000: 500, 1_000_000: 3000}
"""In one slice, by period in ns: three or five seconds each."""
PERCENTILES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9}
NO_PEER = "cyclictest is not installed (Debian package rt-tests)"


def measure() -> list[Row]:
    return [row for period_ns in CYCLES for row in _of_period(period_ns)]


def _of_period(period_ns: int) -> list[Row]:
    ways: dict[str, int | None] = {"plain sleep": 0, "sleep + spin": None}
    latencies: dict[str, list[int]] = {way: [] for way in ways}
    busy: dict[str, list[float]] = {way: [] for way in ways}
    peer: list[int] = []
    refused = ""
    cpu = max(os.sched_getaffinity(0))
    for _ in range(SLICES):
        for way, spin_ns in ways.items():
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                found, share, refused = pool.apply(_loop, (period_ns, spin_ns, cpu))
            latencies[way].extend(found)
            busy[way].append(share)
        peer += _cyclictest(period_ns, cpu)
    rows = []
    where = f"{period_ns / 1e6:g} ms" + (f" (no SCHED_FIFO: {refused})" if refused else "")
    for way, found in latencies.items():
        for name, percent in PERCENTILES.items():
            theirs = float(np.percentile(peer, percent)) / 1000 if peer else None
            rows.append(
                Row(
                    f"wake-up latency {name}, {where}, {way}", float(np.percentile(found, percent)) / 1000,
                    theirs, "us", "cyclictest, same CPU and priority" if peer else NO_PEER,
                )
            )  # fmt: skip
    cost = 100 * float(np.median(busy["sleep + spin"]))
    plain = 100 * float(np.median(busy["plain sleep"]))
    rows.append(Row(f"CPU time of the loop, {where}, sleep + spin", cost, plain, "% of a CPU", "plain sleep"))
    return rows


def _loop(period_ns: int, spin_ns: int | None, cpu: int) -> tuple[list[int], float, str]:
    """Latencies [ns], share of the CPU used, and why SCHED_FIFO was refused if it was."""
    from hil.node import RealTimeClock, realtime
    from hil.node.phase import PHASE_NS, phase_off_the_tick
    from hil.node.spin import choose_spin

    spin = choose_spin(spin_ns, period_ns)  # before the process is kept to one CPU
    rights = realtime.request(PRIORITY, cpu)
    clock = RealTimeClock(period_ns, phase_off_the_tick(period_ns, PHASE_NS), spin=spin)
    latencies = []
    began, busy = time.monotonic(), time.process_time()
    for _ in range(CYCLES[period_ns]):
        start = clock.wait()
        if start is not None:
            latencies.append(start.woke_ns - start.scheduled_ns)
            clock.finished(start.woke_ns)
    share = (time.process_time() - busy) / (time.monotonic() - began)
    return latencies, share, rights.sched_fifo.detail if rights.sched_fifo.state == "refused" else ""


def _cyclictest(period_ns: int, cpu: int) -> list[int]:
    """Latencies [ns] of one slice, whole microseconds; nothing where it is not installed or not permitted."""
    if shutil.which("cyclictest") is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "c.json"
        command = ["cyclictest", "-q", "-m", f"-p{PRIORITY}", f"-a{cpu}", "-t1", f"-i{period_ns // 1000}",
                   f"-l{CYCLES[period_ns]}", "-h100000", f"--json={report}"]  # fmt: skip
        if subprocess.run(command, capture_output=True, check=False).returncode != 0:
            return []
        histogram = json.loads(report.read_text())["thread"]["0"]["histogram"]
    return [int(us) * 1000 for us, count in histogram.items() for _ in range(count)]
