"""What on this host costs most latency, in order, and what to do: from facts and from the run itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hil.bench.timing.host import Host
from hil.bench.timing.request import FULL, LOOP_SPIN, PEER
from hil.bench.timing.samples import Measured, spread
from hil.node.realtime import FIFO_REMEDY, IDLE_REMEDY, MEMORY_REMEDY

__all__ = ["Advice", "advice"]

STEAL_WORTH_TELLING = 0.0005
DEEP_IDLE_US = 50
COMPETITORS_PER_CPU = 0.5
LONG_STALL_US = 500.0


@dataclass(frozen=True)
class Advice:
    """One cause of latency on this host: what it costs (measured here, or by its source), what to do."""

    what: str
    cost: str
    remedy: str


def advice(
    host: Host,
    measured: Mapping[tuple[str, str], Measured],
    steal: Mapping[str, float],
    *,
    fifo: bool,
    priority: int,
    competitors: frozenset[str] = frozenset(),
) -> list[Advice]:
    """The causes that apply here, the most expensive first. `steal`: share of the time, by condition.

    The order is that of the measured effect on loops of 1 and 10 ms: scheduling class (times 10 to 40 at
    p99), stolen CPUs (milliseconds), other work on the same CPUs, sleeping and slow CPUs, the kernel's
    own critical sections, then pauses that are rare.
    """
    found: list[Advice] = []
    if not fifo:
        found.append(_no_fifo(host, priority))
    worst = max(steal.values(), default=0.0)
    stalls_us = _peer_maximum_us(measured)
    if worst >= STEAL_WORTH_TELLING or (host.hypervisor and stalls_us > LONG_STALL_US):
        found.append(
            Advice(
                f"a hypervisor takes the CPUs away ({100 * worst:.2f} % stolen during the run)",
                f"cyclictest was late by up to {stalls_us:.0f} us" if stalls_us else "stalls of milliseconds",
                "run on the metal, or give the virtual machine CPUs of its own (pinning, no overcommit);"
                " nothing inside the machine can prevent it",
            )
        )
    elif host.hypervisor:
        found.append(
            Advice(
                "a virtual machine",
                "no CPU time was stolen during this run; it may be in another",
                "pin its virtual CPUs to CPUs of the host, or run on the metal",
            )
        )
    if host.competitors > COMPETITORS_PER_CPU * host.cpus and not host.isolated:
        found.append(
            Advice(
                f"other work on the same CPUs (load {host.competitors:.1f} on {host.cpus} CPUs)",
                "cold caches, and every delay under SCHED_OTHER" if fifo else "every delay is theirs",
                "end it, or keep a CPU free: boot with isolcpus=N nohz_full=N rcu_nocbs=N, then --cpu N",
            )
        )
    if competitors:
        found.append(
            Advice(
                f"other real-time processes ran meanwhile ({', '.join(sorted(competitors))})",
                "all that they take, if their priority is higher; missed deadlines that no witness explains",
                "end them, or lower them below the bench: chrt -f -p PRIORITY PID",
            )
        )
    slow = [name for name in host.governors if name not in ("", "performance")]
    if slow:
        found.append(
            Advice(
                f"frequency scaling (governor {', '.join(slow)})",
                "the step takes longer whenever the clock was lowered between cycles",
                "cpupower frequency-set -g performance",
            )
        )
    if host.deepest_idle_us is not None and host.deepest_idle_us > DEEP_IDLE_US and not _awake(measured):
        found.append(
            Advice(
                f"deep idle states (exit latency up to {host.deepest_idle_us} us)",
                f"up to {host.deepest_idle_us} us a wake-up; the bench was not allowed to forbid them",
                f"{IDLE_REMEDY}; or boot with processor.max_cstate=1 intel_idle.max_cstate=1",
            )
        )
    if not host.preempt_rt and host.kernel.startswith("Linux"):
        found.append(
            Advice(
                "no PREEMPT_RT kernel",
                "hundreds of us now and then, while the kernel cannot be preempted",
                "install one (Debian: linux-image-rt-amd64); /sys/kernel/realtime then says 1",
            )
        )
    if fifo and not host.isolated and host.cpus > 1:
        found.append(
            Advice(
                "no isolated CPU",
                "interrupts and kernel threads share the CPU of the loop: tens of us",
                "boot with isolcpus=N nohz_full=N rcu_nocbs=N irqaffinity=others, then --cpu N",
            )
        )
    found += _throttling(host, measured)
    if not host.memory_lock:
        found.append(
            Advice(
                f"memory is not locked ({host.memory_lock_detail})"
                if host.memory_lock_detail
                else "memory is not locked",
                "a page fault now and then: 10 us to milliseconds",
                MEMORY_REMEDY,
            )
        )
    return found


def _no_fifo(host: Host, priority: int) -> Advice:
    cost = "p99 10 to 40 times that of SCHED_FIFO, more under load"
    if priority == 0 and host.sched_fifo:
        return Advice("SCHED_OTHER, as asked for with --priority 0", cost, "leave out --priority 0")
    return Advice("no real-time rights: SCHED_FIFO was refused, all ran under SCHED_OTHER", cost, FIFO_REMEDY)


def _awake(measured: Mapping[tuple[str, str], Measured]) -> bool:
    """Whether the bench kept the CPUs out of deep idle states (/dev/cpu_dma_latency) in all its slices."""
    pieces = [piece for (_, part), known in measured.items() if part == FULL for piece in known.slices]
    return bool(pieces) and all(piece.rights.get("cpu_idle") for piece in pieces)


def _throttling(host: Host, measured: Mapping[tuple[str, str], Measured]) -> list[Advice]:
    """The real-time throttle bites when real-time processes want more of a CPU than it leaves them."""
    used = 0.0
    for (_, part), known in measured.items():
        shares = known.cpu_share()
        if part in (FULL, LOOP_SPIN) and shares:
            used = max(used, *shares.values())
    if host.throttle >= 1.0 or used < 0.5 * host.throttle:
        return []
    return [
        Advice(
            f"real-time throttling at {100 * host.throttle:.0f} % of a CPU, {100 * used:.0f} % used",
            "50 ms at a time, once a second, if the share is used up",
            "a shorter spin (--spin), a longer period, or sysctl kernel.sched_rt_runtime_us=-1",
        )
    ]


def _peer_maximum_us(measured: Mapping[tuple[str, str], Measured]) -> float:
    spreads = [spread(known.wakeup_latency_us) for (_, part), known in measured.items() if part == PEER]
    return max((known.max for known in spreads if known is not None), default=0.0)
