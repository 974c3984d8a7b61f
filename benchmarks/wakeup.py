"""Wake-up latency of the bench's loop, in slices that alternate with cyclictest."""

from __future__ import annotations

import json
import multiprocessing
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.rows import Row

PERIOD_NS = 10_000_000
SLICES, CYCLES = 6, 400
PRIORITY = 80


def measure() -> list[Row]:
    ours: dict[int, list[int]] = {0: [], 200_000: []}
    peer: list[int] = []
    for _ in range(SLICES):
        for spin_ns, latencies in ours.items():
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                latencies.extend(pool.apply(_loop, (spin_ns,)))
        peer += _cyclictest()
    rows = []
    for spin_ns, latencies in ours.items():
        for name, percent in (("p50", 50), ("p99", 99)):
            theirs = float(np.percentile(peer, percent)) if peer else None
            what = f"wake-up latency {name}, 10 ms, " + (
                f"spin {spin_ns // 1000} us" if spin_ns else "plain sleep"
            )
            is_ = "cyclictest" if peer else "cyclictest is not installed (Debian package rt-tests)"
            rows.append(
                Row(
                    what, float(np.percentile(latencies, percent)) / 1000, theirs and theirs / 1000, "us", is_
                )
            )
    return rows


def _loop(spin_ns: int) -> list[int]:
    from hil.node import RealTimeClock, realtime

    realtime.request(PRIORITY, None)
    clock = RealTimeClock(PERIOD_NS, 700_000, spin_ns)
    latencies = []
    for _ in range(CYCLES):
        start = clock.wait()
        if start is not None:
            latencies.append(start.woke_ns - start.scheduled_ns)
            clock.finished(start.woke_ns)
    return latencies


def _cyclictest() -> list[int]:
    if shutil.which("cyclictest") is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "c.json"
        command = [
            "cyclictest",
            "-q",
            "-m",
            f"-p{PRIORITY}",
            f"-i{PERIOD_NS // 1000}",
            f"-l{CYCLES}",
            "-h10000",
        ]
        subprocess.run([*command, f"--json={report}"], check=True, capture_output=True)
        histogram = json.loads(report.read_text())["thread"]["0"]["histogram"]
    return [int(us) * 1000 for us, count in histogram.items() for _ in range(count)]
