"""What this host is, as far as it decides about latency: read from /proc and /sys before and after a run."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.bench.rights import processor_rights
from hil.bench.timing.request import TimingRequest

__all__ = ["CpuTimes", "Host", "cpu_times", "read_host"]

SYSTEM = Path("/sys/devices/system")
HYPERVISOR_FLAG = "hypervisor"
REALTIME_POLICIES = ("1", "2", "6")


@dataclass(frozen=True)
class CpuTimes:
    """Jiffies of all CPUs together since the start of the machine, of /proc/stat."""

    total: int = 0
    busy: int = 0
    steal: int = 0

    def shares_since(self, before: CpuTimes) -> tuple[float, float]:
        """Share of the time since then in which a CPU was busy, and was taken by the hypervisor; 0 to 1."""
        total = self.total - before.total
        if total <= 0:
            return 0.0, 0.0
        return (self.busy - before.busy) / total, (self.steal - before.steal) / total


@dataclass(frozen=True)
class Host:
    """Facts about the machine; None or empty: it does not say.

    `throttle`: share of a CPU's time that real-time processes may have. `governors`: frequency governors of
    the CPUs. `isolated`: CPUs kept free of other work at boot. `deepest_idle_us`: exit latency of the deepest
    idle state that is enabled. `competitors`: other processes that wanted a CPU when the run began.
    """

    kernel: str
    cpus: int
    preempt_rt: bool
    governors: tuple[str, ...]
    hypervisor: bool
    throttle: float
    isolated: str
    deepest_idle_us: int | None
    sched_fifo: bool
    memory_lock: bool
    memory_lock_detail: str
    competitors: float

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON."""
        return asdict(self) | {"governors": list(self.governors)}


def read_host() -> Host:
    """Look at this machine. Never raises: what cannot be read is not known."""
    fifo, lock, lock_detail = processor_rights()
    throttle = realtime_share()
    flags = _text("/proc/cpuinfo")
    return Host(
        kernel=f"{platform.system()} {platform.release()}",
        cpus=os.cpu_count() or 1,
        preempt_rt=_text("/sys/kernel/realtime") == "1",
        governors=tuple(
            sorted({_text(path) for path in SYSTEM.glob("cpu/cpu[0-9]*/cpufreq/scaling_governor")})
        ),
        hypervisor=any(
            HYPERVISOR_FLAG in line.split()
            for line in flags.splitlines()
            if line.startswith(("flags", "Features"))
        ),
        throttle=throttle,
        isolated=_text(SYSTEM / "cpu/isolated"),
        deepest_idle_us=_deepest_idle_us(),
        sched_fifo=fifo,
        memory_lock=lock,
        memory_lock_detail=lock_detail,
        competitors=_running(),
    )


def cpu_times(read: Callable[[], str] = lambda: _text("/proc/stat")) -> CpuTimes:
    """The first line of /proc/stat: user, nice, system, idle, iowait, irq, softirq, steal (proc(5))."""
    for line in read().splitlines():
        name, *numbers = line.split()
        if name == "cpu" and len(numbers) >= 8:
            user, nice, system, idle, iowait, irq, softirq, steal = (int(n) for n in numbers[:8])
            busy = user + nice + system + irq + softirq
            return CpuTimes(busy + idle + iowait + steal, busy, steal)
    return CpuTimes()


def realtime_processes() -> frozenset[str]:
    """Names of the processes under SCHED_FIFO, SCHED_RR or SCHED_DEADLINE now, kernel threads apart.

    Called between slices, when none of the measurement's own runs.
    """
    found = set()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        name, _, rest = _text(stat).rpartition(")")
        fields = rest.split()
        # Fields 4 (parent), 23 (memory) and 41 (policy) of proc_pid_stat(5); a kernel thread maps no memory.
        if len(fields) > 38 and fields[38] in REALTIME_POLICIES and fields[20] != "0":
            found.add(name.partition("(")[2])
    return frozenset(found)


def realtime_share() -> float:
    """Share of a CPU's time that the kernel leaves to real-time processes; 1.0: no throttle."""
    from hil.node.spin import real_time_share

    return real_time_share()


def rights_of(request: TimingRequest, host: Host) -> tuple[bool, bool]:
    """Whether this measurement runs under SCHED_FIFO, and with locked memory."""
    return host.sched_fifo and request.priority > 0, host.memory_lock


def _deepest_idle_us() -> int | None:
    latencies = []
    for state in SYSTEM.glob("cpu/cpu0/cpuidle/state*"):
        if _text(state / "disable") == "0" and _text(state / "latency").isdigit():
            latencies.append(int(_text(state / "latency")))
    return max(latencies, default=None)


def _running() -> float:
    """Other processes that run or want to, on average over the last minute."""
    try:
        return os.getloadavg()[0]
    except (OSError, AttributeError):
        return 0.0


def _text(path: Path | str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
