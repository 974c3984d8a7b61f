"""The bench's empty loop as a process: `python -m hil.bench.timing.loop …`, what a node is without work.

It writes the wake-ups as pairs of int64 (deadline, wake-up; monotonic ns) and a JSON line about itself on
standard output.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from hil.bench.errors import BenchError
from hil.bench.timing.samples import Slice
from hil.node import RealTimeClock, realtime
from hil.node.phase import PHASE_NS, phase_off_the_tick
from hil.node.spin import choose_spin

__all__ = ["main", "measure_loop"]

WARM_UP_S = 0.2
"""Wake-ups so soon after the start are not counted, as in the nodes' overload policy."""


def measure_loop(
    *,
    period_ns: int,
    cycles: int,
    spin_ns: int | None,
    priority: int,
    cpu: int | None,
    waiting: Callable[[], None],
) -> Slice:
    """One slice of the empty loop in a new process; `waiting` is called meanwhile and may raise.

    Raises BenchError.
    """
    with tempfile.TemporaryDirectory(prefix="hil-timing-") as folder:
        file = Path(folder) / "wakeups"
        line = [sys.executable, "-m", "hil.bench.timing.loop", "--out", str(file)]
        line += ["--period-ns", str(period_ns), "--cycles", str(cycles), "--priority", str(priority)]
        line += [] if spin_ns is None else ["--spin-ns", str(spin_ns)]
        line += [] if cpu is None else ["--cpu", str(cpu)]
        process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            while process.poll() is None:
                waiting()
                time.sleep(0.02)
        finally:
            if process.poll() is None:
                process.terminate()
            about, words = process.communicate()
        if process.returncode != 0:
            last = words.strip().splitlines()[-1] if words.strip() else "it said nothing"
            raise BenchError(f"the empty loop ended with exit code {process.returncode}: {last}")
        pairs = np.fromfile(file, np.int64).reshape(-1, 2)
    said = json.loads(about)
    return slice_of(pairs, said["cpu_share"], said["rights"], said["skipped"])


def slice_of(pairs: np.ndarray, cpu_share: float, rights: dict[str, object], skipped: int) -> Slice:
    """Latency and period error of wake-ups, (n, 2): deadline and wake-up, ns."""
    deadline, woke = pairs[:, 0], pairs[:, 1]
    return Slice(
        wakeup_latency_us=(woke - deadline) / 1e3,
        period_error_us=(np.diff(woke) - np.diff(deadline)) / 1e3,
        cpu_share={"loop": cpu_share},
        missed={"loop": skipped},
        rights=rights,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Loop for a number of cycles; exit code 0."""
    parser = argparse.ArgumentParser(prog="hil.bench.timing.loop", description="The bench's loop, empty.")
    for name, default in (
        ("period-ns", None),
        ("cycles", None),
        ("priority", 0),
        ("spin-ns", -1),
        ("cpu", -1),
    ):
        parser.add_argument(f"--{name}", type=int, default=default, required=default is None)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args(argv)
    period_ns = asked.period_ns
    spin = choose_spin(None if asked.spin_ns < 0 else asked.spin_ns, period_ns)
    warm_up = max(10, round(WARM_UP_S * 1e9 / period_ns))
    wakeups = array("q", bytes(16 * (warm_up + asked.cycles)))
    rights = realtime.request(asked.priority, None if asked.cpu < 0 else asked.cpu)
    clock = RealTimeClock(period_ns, phase_off_the_tick(period_ns, PHASE_NS), spin=spin)
    skipped, begun, used = 0, 0, 0.0
    monotonic = time.monotonic_ns
    for cycle in range(warm_up + asked.cycles):
        if cycle == warm_up:
            begun, used = monotonic(), time.process_time()
        start = clock.wait()
        if start is None:  # pragma: no cover - nobody stops it
            break
        wakeups[2 * cycle] = start.scheduled_ns
        wakeups[2 * cycle + 1] = start.woke_ns
        if cycle > warm_up:
            skipped += start.skipped
        clock.finished(monotonic())
    used = (time.process_time() - used) / ((monotonic() - begun) * 1e-9)
    asked.out.write_bytes(wakeups[2 * warm_up :].tobytes())
    print(json.dumps({"cpu_share": used, "skipped": skipped, "rights": rights.as_dict(), "pid": os.getpid()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
