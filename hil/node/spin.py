"""How long before a deadline a node stops sleeping and polls the clock: chosen once, adapted every cycle.

A sleep ends tens of microseconds late, and now and then hundreds; polling the clock for the last stretch
hides that at the price of CPU time. The stretch need not be longer than sleeps are late on this machine:
it follows a high quantile of the overshoot that was measured, between limits.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["AdaptiveMargin", "SpinChoice", "choose_spin", "real_time_share", "usable_cpus"]

SMALLEST_NS = 100_000
LARGEST_NS = 300_000
"""Measured beside cyclictest on a shared virtual machine: a spin of 300 us hid all but 1 of 1000 late
wake-ups, one of 150 us all but 1 of 100."""

GUARD_NS = 20_000
"""Added to the quantile: the clock is read some time after the sleep has ended, with cold caches."""

QUANTILE_STEP_NS = 25_000
MISSED_PER_MILLE = 2
"""The margin settles where 2 of 1000 sleeps overshoot it: a late one adds nearly a step, one in time takes
off 1/500 of that, so a single stall is forgotten within some hundred cycles (stochastic approximation of
a quantile, Robbins and Monro 1951)."""

BUDGET_SHARE = 0.25
"""Share of one CPU that polling may take at most."""

RT_SHARE = Path("/proc/sys/kernel/sched_rt_runtime_us"), Path("/proc/sys/kernel/sched_rt_period_us")


@dataclass(frozen=True)
class SpinChoice:
    """What was chosen: `mode` is "auto", "fixed" or "off", `why` the reason in words; margins in ns."""

    mode: str
    why: str
    smallest_ns: int = 0
    largest_ns: int = 0

    def margin(self) -> AdaptiveMargin:
        """A margin with these limits."""
        return AdaptiveMargin(self.smallest_ns, self.largest_ns)


class AdaptiveMargin:
    """The margin now, `now_ns`, kept between `smallest_ns` and `largest_ns`; it starts at the largest.

    Equal limits are a fixed margin. `observe` costs less than half a microsecond and allocates nothing.
    """

    __slots__ = ("_late_ns", "_rise_ns", "_sink_ns", "largest_ns", "now_ns", "smallest_ns")

    def __init__(
        self, smallest_ns: int, largest_ns: int, *, missed_per_mille: int = MISSED_PER_MILLE
    ) -> None:
        if not 0 <= smallest_ns <= largest_ns:
            raise ValueError(f"margins {smallest_ns} to {largest_ns} ns must be positive and in order")
        self.smallest_ns = smallest_ns
        self.largest_ns = largest_ns
        self.now_ns = largest_ns
        self._late_ns = largest_ns - GUARD_NS
        self._sink_ns = QUANTILE_STEP_NS * missed_per_mille // 1000
        self._rise_ns = QUANTILE_STEP_NS - self._sink_ns

    def observe(self, overshoot_ns: int) -> None:
        """One sleep has ended `overshoot_ns` after it should have."""
        if overshoot_ns > self._late_ns:
            late_ns = self._late_ns + self._rise_ns
        else:
            late_ns = self._late_ns - self._sink_ns
        margin_ns = late_ns + GUARD_NS
        if margin_ns >= self.largest_ns:
            self.now_ns, self._late_ns = self.largest_ns, self.largest_ns - GUARD_NS
        elif margin_ns <= self.smallest_ns:
            self.now_ns, self._late_ns = self.smallest_ns, self.smallest_ns - GUARD_NS
        else:
            self.now_ns, self._late_ns = margin_ns, late_ns


def choose_spin(
    asked_ns: int | None, period_ns: int, *, cpus: int | None = None, rt_share: float | None = None
) -> SpinChoice:
    """The spin of a loop of `period_ns`; `asked_ns` None: as the machine allows, 0: none, else that long.

    `cpus` are those that this process may use, `rt_share` the share of a CPU that the kernel leaves to
    real-time processes (1.0: all); None: ask the system. Polling is given up where there is one CPU for all
    nodes, and never takes more than a quarter of a CPU, or half of what the real-time throttle leaves.
    """
    if asked_ns == 0:
        return SpinChoice("off", "asked for")
    share = min(BUDGET_SHARE, (real_time_share() if rt_share is None else rt_share) / 2)
    budget_ns = int(period_ns * share)
    if asked_ns is not None:
        largest_ns = period_ns // 2
        if asked_ns > largest_ns:
            return SpinChoice("fixed", f"asked for, cut to half of the period of {period_ns / 1e6:g} ms",
                              largest_ns, largest_ns)  # fmt: skip
        return SpinChoice("fixed", "asked for", asked_ns, asked_ns)
    if (usable_cpus() if cpus is None else cpus) < 2:
        return SpinChoice("off", "one CPU for all nodes: polling would keep it from the others")
    if budget_ns < SMALLEST_NS:
        return SpinChoice(
            "off",
            f"{SMALLEST_NS / 1000:g} us of a period of {period_ns / 1e6:g} ms are more than "
            f"{100 * share:.3g} % of a CPU",
        )
    return SpinChoice("auto", f"at most {100 * share:.3g} % of a CPU", SMALLEST_NS,
                      min(LARGEST_NS, budget_ns))  # fmt: skip


def usable_cpus() -> int:
    """CPUs that this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except (AttributeError, OSError):
        return os.cpu_count() or 1


def real_time_share(read: Callable[[Path], str] = Path.read_text) -> float:
    """Share of a CPU's time that the kernel lets real-time processes have (sched_rt_runtime_us), 0 to 1.

    Linux keeps 5 % from them by default (kernel documentation, sched-rt-group). 1.0: no throttle.
    """
    try:
        runtime_us, period_us = (int(read(path)) for path in RT_SHARE)
    except (OSError, ValueError):
        return 1.0
    if runtime_us < 0 or period_us <= 0:
        return 1.0
    return min(1.0, runtime_us / period_us)


def spin_report(choice: SpinChoice, margin: AdaptiveMargin, period_ns: int) -> dict[str, Any]:
    """What was chosen and what it costs now, ready for JSON; `cpu_share` of one CPU, polling alone."""
    return {
        "mode": choice.mode,
        "why": choice.why,
        "margin_ns": margin.now_ns,
        "smallest_ns": margin.smallest_ns,
        "largest_ns": margin.largest_ns,
        "cpu_share": round(margin.now_ns / period_ns, 4),
    }
