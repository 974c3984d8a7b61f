"""cyclictest (rt-tests) as the peer of the loop, and as the witness of stalls during a run.

The witness is one measuring thread per CPU, above all processes of the bench in priority, so that it is late
only when kernel, firmware or hypervisor hold up the CPU. `--spike` makes cyclictest keep each late wake-up
with its CLOCK_MONOTONIC time, which is the time base of the nodes' timing rings.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from hil.bench.errors import BenchError
from hil.bench.timing.misses import Stall
from hil.bench.timing.samples import Slice, from_histogram

__all__ = ["MISSING", "Cyclictest", "Witness", "parse_report", "parse_spikes"]

MISSING = "cyclictest is not installed (Debian package rt-tests): no ratios and no witness"
HISTOGRAM_US = 100_000
SPIKE = re.compile(r"^T:\s*(\d+) Spike:\s*(\d+): TS:\s*(\d+)\s*$", re.MULTILINE)
VERSION = re.compile(r"V (\d+[\w.]*)")
MOST_SPIKES = 200_000
ALIGN_S = 2.1
"""cyclictest begins aligned wake-ups at the next full second, or at the one after it."""
NS_PER_US = 1000


@dataclass(frozen=True)
class Cyclictest:
    """The program of this machine, and what it may do here."""

    program: str
    version: str
    has_spikes: bool
    fifo: bool
    lock_memory: bool

    @classmethod
    def find(cls, *, fifo: bool, lock_memory: bool) -> Cyclictest | None:
        """The installed one, or None."""
        program = shutil.which("cyclictest")
        if program is None:
            return None
        done = subprocess.run([program, "--help"], capture_output=True, text=True, check=False)
        text = done.stdout + done.stderr
        version = VERSION.search(text)
        return cls(program, version[1] if version else "", "--spike" in text, fifo, lock_memory)

    def refusal(self) -> str:
        """Why it does not run here; empty if it does. Without the right to SCHED_FIFO it refuses."""
        line = [*self.command(period_ns=1_000_000, priority=1), "-t", "1", "-l", "2"]
        done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=10.0)
        return "" if done.returncode == 0 else _last_line(done.stderr + done.stdout)

    def command(self, *, period_ns: int, priority: int) -> list[str]:
        """Command line with the rights that this process has: without them cyclictest would refuse to run."""
        line = [self.program, "-q", "-i", str(max(1, period_ns // NS_PER_US)), "-d", "0"]
        line += ["-p", str(priority)] if self.fifo and priority else ["-p", "0", "--policy=other"]
        return [*line, "-m"] if self.lock_memory else line

    def measure(
        self, *, period_ns: int, cycles: int, priority: int, cpu: int | None, waiting: Callable[[], None]
    ) -> Slice:
        """One slice with one thread; `waiting` is called while it runs and may raise. Raises BenchError."""
        with tempfile.TemporaryDirectory(prefix="hil-timing-") as folder:
            report = Path(folder) / "report.json"
            line = self.command(period_ns=period_ns, priority=priority)
            line += ["-t", "1", "-l", str(cycles), "-h", str(HISTOGRAM_US), f"--json={report}"]
            if cpu is not None:
                line += ["-a", str(cpu)]
            process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            try:
                while process.poll() is None:
                    waiting()
                    time.sleep(0.02)
                    used = _cpu_seconds(process.pid) or 0.0
            finally:
                if process.poll() is None:
                    process.terminate()
                words = process.communicate()[1]
            document = _read(report)
            if process.returncode != 0 or not document:
                raise BenchError(f"cyclictest ended with exit code {process.returncode}: {_last_line(words)}")
        slice_ = parse_report(document)
        elapsed = cycles * period_ns * 1e-9
        return Slice(
            slice_.wakeup_latency_us,
            cpu_share={"cyclictest": used / elapsed},
            rights={"sched_fifo": self.fifo and priority > 0, "mlock": self.lock_memory},
        )


class Witness:
    """cyclictest beside a run, one thread per CPU (or on `cpu` alone); `stop` says when the machine stalled.

    Its wake-ups lie at k * period + offset (then it begins up to ALIGN_S late). Stalls of less than
    `threshold_us` are not kept. Raises BenchError if it ends by itself.
    """

    def __init__(
        self,
        peer: Cyclictest,
        *,
        period_ns: int,
        priority: int,
        cpu: int | None,
        threshold_us: int,
        offset_ns: int | None = None,
    ) -> None:
        self.threshold_us = threshold_us
        self._folder = tempfile.TemporaryDirectory(prefix="hil-witness-")
        report = Path(self._folder.name) / "report.json"
        line = peer.command(period_ns=period_ns, priority=priority)
        line += ["-a", "-t"] if cpu is None else ["-a", str(cpu), "-t", "1"]
        line += [f"--spike={threshold_us}", f"--spike-nodes={MOST_SPIKES}", f"--json={report}"]
        if offset_ns is not None:
            line.append(f"--secaligned={offset_ns // NS_PER_US}")
        self._process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def abandon(self) -> None:
        """Make sure that it does not outlive the run; nothing to do after `stop`."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.communicate()
        self._folder.cleanup()

    def stop(self) -> list[Stall]:
        """End it; the stalls in order of time. Raises BenchError if it had ended before."""
        early = self._process.poll()
        if early is None:
            self._process.send_signal(signal.SIGINT)
        try:
            out, words = self._process.communicate(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            out, words = self._process.communicate()
        finally:
            self._folder.cleanup()
        if early is not None:
            raise BenchError(f"the witness (cyclictest) ended with exit code {early}: {_last_line(words)}")
        return parse_spikes(out)


def parse_report(document: dict[str, Any]) -> Slice:
    """Wake-up latencies of the first thread of a report in cyclictest's JSON."""
    thread = document["thread"]["0"]
    counts = {int(us): int(count) for us, count in thread["histogram"].items()}
    overflows = int(thread["cycles"]) - sum(counts.values())
    return Slice(from_histogram(counts, overflows=overflows, maximum_us=float(thread["max"])))


def parse_spikes(text: str) -> list[Stall]:
    """The stalls in cyclictest's output with --spike: thread, lateness and time of the wake-up, us."""
    stalls = [
        Stall(int(cpu), (int(stamp) - int(late)) * NS_PER_US, int(stamp) * NS_PER_US)
        for cpu, late, stamp in SPIKE.findall(text)
    ]
    return sorted(stalls, key=lambda stall: stall.end_ns)


def offset_between(deadlines_ns: Sequence[int], period_ns: int) -> int:
    """The offset of a grid of `period_ns` that stays farthest from these deadlines.

    Periods of nodes are multiples of the witness's. On one grid with a deadline the witness would delay every
    cycle of the node by the microseconds of its own wake-up.
    """
    places = sorted({deadline % period_ns for deadline in deadlines_ns}) or [0]
    gaps = [(later - earlier, earlier) for earlier, later in pairwise([*places, places[0] + period_ns])]
    width, start = max(gaps)
    return (start + width // 2) % period_ns


def witness_period_ns(period_ns: int) -> int:
    """How often the witness looks: twice in a period, at least every 5 ms, at most every 200 us.

    More often costs the control step, because every wake-up takes some of its caches: with a look every ms
    the median execution of a 10 ms loop was 178 us, in a run without a witness minutes before it 116 us.
    """
    return max(200_000, min(5_000_000, period_ns // 2))


def cpu_seconds(pid: int) -> float | None:
    """CPU time that a process has used [s]; None if it cannot be told."""
    return _cpu_seconds(pid)


def _cpu_seconds(pid: int) -> float | None:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2]
        user, system = fields.split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return None


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return document if isinstance(document, dict) else {}


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else "it said nothing"
