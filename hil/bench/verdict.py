"""The verdict: criteria with value, limit and unit, taken from a run's metrics and its counters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from hil.bench.metrics import ControlMetrics
from hil.bench.scenario import Limits


@dataclass(frozen=True)
class Criterion:
    """One measured value against its limit; passed if |value| <= limit."""

    name: str
    value: float | None
    limit: float
    unit: str

    @property
    def passed(self) -> bool:
        """Whether the value is known and within the limit."""
        return self.value is not None and abs(self.value) <= self.limit

    def as_dict(self) -> dict[str, Any]:
        """The criterion as summary.json has it."""
        return {**asdict(self), "passed": self.passed}


@dataclass(frozen=True)
class Counters:
    """What the bus, the clocks and the supervision counted over a run.

    None: not known, because the process that counted did not end well. Not known is not passed.
    """

    deadline_misses: Mapping[str, int | None]  # per real-time process
    consecutive_misses: Mapping[str, int | None]
    frames_lost: int | None
    e2e_rejected: int | None
    cycles_not_recorded: int | None
    interventions: int | None


def criteria(
    metrics: ControlMetrics, counters: Counters, limits: Limits, *, timetable_s: float, real_time: bool
) -> list[Criterion]:
    """All criteria of a run, in the order in which people ask for them.

    Overspeed is one-sided: a train below the permitted speed has an overspeed of 0.
    Deadlines are judged in real time only.
    """
    overspeed = metrics.max_overspeed_mps
    trip_error = None if metrics.trip_time_s is None else metrics.trip_time_s - timetable_s
    rows = [
        Criterion("stop_error", metrics.stop_error_m, limits.stop_error_m, "m"),
        Criterion("rms_speed_error", metrics.rms_speed_error_mps, limits.rms_speed_error_mps, "m/s"),
        Criterion(
            "overspeed", None if overspeed is None else max(0.0, overspeed), limits.overspeed_mps, "m/s"
        ),
        Criterion("jerk", metrics.max_jerk_mps3, limits.jerk_mps3, "m/s^3"),
        Criterion("trip_time_error", trip_error, limits.trip_time_error_s, "s"),
        Criterion("frames_lost", counters.frames_lost, 0, "frames"),
        Criterion("e2e_rejected", counters.e2e_rejected, 0, "frames"),
        Criterion("cycles_not_recorded", counters.cycles_not_recorded, 0, "cycles"),
        Criterion("interventions", counters.interventions, limits.max_interventions, "times"),
    ]
    if real_time:
        for process, misses in counters.deadline_misses.items():
            rows.append(Criterion(f"deadline_misses_{process}", misses, limits.max_deadline_misses, "cycles"))
        for process, misses in counters.consecutive_misses.items():
            rows.append(
                Criterion(
                    f"consecutive_misses_{process}", misses, limits.max_consecutive_deadline_misses, "cycles"
                )
            )
    return rows


def verdict(rows: list[Criterion], *, ended: str) -> str:
    """`passed`, `failed` or `aborted`. `ended` says how the run ended: only `arrived` can pass."""
    if ended == "aborted":
        return "aborted"
    return "passed" if ended == "arrived" and all(row.passed for row in rows) else "failed"
