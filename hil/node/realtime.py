"""Real-time rights of this process: asked for one by one, each reported as granted or refused.

Nothing here raises: a bench without rights still runs, and its report says what was missing. What each
right is good for was measured with absolute-deadline loops of 1 and 10 ms: SCHED_FIFO changes the p99 of
the wake-up latency by an order of magnitude, the others remove rare pauses.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import struct
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hil.node.spin import real_time_share

__all__ = ["DMA_LATENCY", "IDLE_REMEDY", "RealTimeRights", "Right", "request"]

PR_SET_PDEATHSIG = 1
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2
CAP_IPC_LOCK = 14
CAP_SYS_NICE = 23
DMA_LATENCY = Path("/dev/cpu_dma_latency")
THROTTLE = Path("/proc/sys/kernel/sched_rt_runtime_us")
# What the process may still map after the lock without running into its limit.
LOCK_HEADROOM_BYTES = 64 * 2**20

FIFO_REMEDY = (
    "run as root, or add '@realtime - rtprio 99' to /etc/security/limits.d/ and log in anew; "
    "in a container: --cap-add=sys_nice --ulimit rtprio=99"
)
MEMORY_REMEDY = (
    "add '@realtime - memlock unlimited' to /etc/security/limits.d/ and log in anew; "
    "in a container: --cap-add=ipc_lock --ulimit memlock=-1"
)

ON_LINUX = "run the bench on Linux"
CGROUP_REMEDY = (
    "this kernel shares out real-time time by cgroup (CONFIG_RT_GROUP_SCHED): move the shell into the root "
    "group (echo $$ > /sys/fs/cgroup/cgroup.procs), or give its group cpu.rt_runtime_us; "
    "in a container: --cpu-rt-runtime=950000 --ulimit rtprio=99 --cap-add=sys_nice"
)
IDLE_REMEDY = (
    'run as root, or let a group use it: KERNEL=="cpu_dma_latency", GROUP="realtime", MODE="0660" '
    "in /etc/udev/rules.d/; in a container: --device=/dev/cpu_dma_latency"
)


@dataclass(frozen=True)
class Right:
    """One right: `state` is "granted", "refused" or "not asked for"; `detail` why, `remedy` what to do."""

    name: str
    state: str
    detail: str = ""
    remedy: str = ""

    @property
    def granted(self) -> bool:
        """Whether the process has it."""
        return self.state == "granted"


@dataclass(frozen=True)
class RealTimeRights:
    """What the process asked for and got."""

    sched_fifo: Right
    memory_lock: Right
    timer_slack: Right
    garbage_collector: Right
    cpu_affinity: Right
    cpu_idle: Right

    def __iter__(self) -> Any:
        return iter(
            (self.sched_fifo, self.memory_lock, self.timer_slack, self.garbage_collector, self.cpu_affinity,
             self.cpu_idle)
        )  # fmt: skip

    @property
    def refused(self) -> tuple[Right, ...]:
        """The rights that were asked for and refused."""
        return tuple(right for right in self if right.state == "refused")

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON: every right by name, and the short answers `sched_fifo` and `mlock`."""
        return {
            "sched_fifo": self.sched_fifo.granted,
            "mlock": self.memory_lock.granted,
            "rights": {right.name: asdict(right) for right in self},
        }


def request(priority: int, cpu: int | None, lock_memory: bool = True) -> RealTimeRights:
    """Ask for SCHED_FIFO at `priority` (0: do not), memory lock, 1 ns timer slack, affinity to `cpu`, and,
    with a priority, for CPUs that stay out of deep idle states (/dev/cpu_dma_latency).

    The garbage collector is run, frozen and switched off: what lives now is never scanned again. Call it
    after warm-up and before the loop. Never raises.
    """
    return RealTimeRights(
        garbage_collector=_freeze_garbage_collector(),
        timer_slack=_attempt("timer_slack", _timer_slack, ""),
        memory_lock=_lock_memory() if lock_memory else Right("memory_lock", "not asked for"),
        cpu_affinity=_pin(cpu),
        cpu_idle=_stay_awake() if priority > 0 else Right("cpu_idle", "not asked for"),
        sched_fifo=_sched_fifo(priority),
    )


def none_requested() -> RealTimeRights:
    """The rights of a process that asked for none (lockstep)."""
    names = ("sched_fifo", "memory_lock", "timer_slack", "garbage_collector", "cpu_affinity", "cpu_idle")
    return RealTimeRights(*(Right(name, "not asked for") for name in names))


@contextlib.contextmanager
def kept_off(cpu: int | None) -> Iterator[None]:
    """Keep this process off a CPU meanwhile; a child that is started in there stays off it. Never raises."""
    before = os.sched_getaffinity(0) if cpu is not None and hasattr(os, "sched_getaffinity") else set()
    others = before - {cpu}
    moves = bool(others) and others != before
    if moves:
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, others)
    try:
        yield
    finally:
        if moves:
            with contextlib.suppress(OSError):
                os.sched_setaffinity(0, before)


def die_with_parent(signal_number: int) -> bool:
    """Have the kernel send this process a signal when its parent's starting thread ends; Linux only."""
    try:
        _prctl(PR_SET_PDEATHSIG, signal_number)
    except (OSError, AttributeError):
        return False
    return True


def _attempt(name: str, action: Callable[[], str], remedy: str) -> Right:
    """Run one request and turn whatever it meets into a report."""
    try:
        return Right(name, "granted", action())
    except PermissionError as error:
        return Right(name, "refused", f"not permitted ({error.strerror or error})", remedy)
    except AttributeError:
        return Right(name, "refused", f"{sys.platform} has no such call", ON_LINUX)
    except (OSError, ValueError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return Right(name, "refused", reason, remedy)


def _freeze_garbage_collector() -> Right:
    gc.collect()
    gc.freeze()
    gc.disable()
    return Right("garbage_collector", "granted", "frozen and off")


def _sched_fifo(priority: int) -> Right:
    if priority <= 0:
        return Right("sched_fifo", "not asked for")

    def ask() -> str:
        highest = os.sched_get_priority_max(os.SCHED_FIFO)
        if priority > highest:
            raise ValueError(f"priority {priority} is above the highest, {highest}")
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return f"priority {priority}{_throttled()}"

    # Root that is refused is refused by its cgroup, which has no share of the real-time time.
    capable = bool(_status_field("CapEff", 16) & (1 << CAP_SYS_NICE))
    return _attempt("sched_fifo", ask, CGROUP_REMEDY if capable else FIFO_REMEDY)


def _throttled() -> str:
    """What the kernel keeps from real-time processes, in words; nothing where it keeps nothing."""
    share = real_time_share()
    if share >= 1.0:
        return ""
    return f"; the kernel stops real-time processes after {100 * share:.3g} % of a CPU ({THROTTLE})"


def _stay_awake() -> Right:
    """Ask the kernel for wake-ups without delay (kernel documentation, PM Quality Of Service).

    The request holds as long as the file is open: it is never closed, and ends with the process.
    """

    def ask() -> str:
        if not _held:
            handle = os.open(DMA_LATENCY, os.O_WRONLY)
            try:
                os.write(handle, struct.pack("=i", 0))
            except OSError:
                os.close(handle)
                raise
            _held.append(handle)
        return "CPU wake-up latency limited to 0 us"

    return _attempt("cpu_idle", ask, IDLE_REMEDY if sys.platform.startswith("linux") else ON_LINUX)


_held: list[int] = []


def _pin(cpu: int | None) -> Right:
    if cpu is None:
        return Right("cpu_affinity", "not asked for")

    def ask() -> str:
        # The kernel is asked, not the present affinity: that leaves out CPUs isolated at boot (isolcpus).
        try:
            os.sched_setaffinity(0, {cpu})
        except (OSError, ValueError, OverflowError) as error:
            if isinstance(error, PermissionError):
                raise
            allowed = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
            raise ValueError(f"CPU {cpu} is not to be had; the process runs on {allowed}") from None
        return f"CPU {cpu}"

    return _attempt("cpu_affinity", ask, "choose one of the CPUs that `taskset -p $$` shows")


def _timer_slack() -> str:
    _prctl(PR_SET_TIMERSLACK, 1)
    return "1 ns"


def _lock_memory() -> Right:
    def ask() -> str:
        library = _c_library()
        limit = _lock_limit()
        mapped = _mapped_bytes()
        # With a finite limit the lock may succeed now and make a later allocation fail.
        if limit is not None and mapped + LOCK_HEADROOM_BYTES > limit:
            raise OSError(
                0, f"the limit of locked memory is {limit // 1024} KiB, the process maps {mapped // 1024} KiB"
            )
        # Both flags or none: MCL_FUTURE alone is granted beyond the limit and breaks every later allocation.
        if library.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        return "current and future pages"

    return _attempt("memory_lock", ask, MEMORY_REMEDY)


def _c_library() -> Any:
    if not sys.platform.startswith("linux"):
        raise AttributeError("not Linux")
    return ctypes.CDLL(None, use_errno=True)


def _prctl(option: int, value: int) -> None:
    if _c_library().prctl(option, ctypes.c_ulong(value), 0, 0, 0) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _lock_limit() -> int | None:
    """RLIMIT_MEMLOCK in bytes; None when there is no limit for this process."""
    import resource  # not on every platform

    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft == resource.RLIM_INFINITY or _status_field("CapEff", 16) & (1 << CAP_IPC_LOCK):
        return None
    return soft


def _mapped_bytes() -> int:
    return _status_field("VmSize", 10) * 1024


def _status_field(name: str, base: int) -> int:
    """One number of /proc/self/status; 0 when it is not there."""
    for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1], base)
    return 0
