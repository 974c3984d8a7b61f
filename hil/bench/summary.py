"""summary.json: a recorded run judged, in the shape that the design fixes. SI units, JSON types."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.bench.metrics import Array, ControlMetrics, Tracking, Truth, control_metrics, percentiles_us
from hil.bench.outcome import Outcome, RunOptions
from hil.bench.verdict import Counters, criteria, verdict
from hil.canbus.contract import Contract

if TYPE_CHECKING:
    from hil.record import Run

PROCESSES = ("controller", "plant_sim")
DRIVING_MODES = ("RUN", "STOPPING")
TAKEN_OVER_MODES = ("DEGRADED", "EMERGENCY")


class Probes(Protocol):
    """A run whose inner values can be read: a recorded one, or one in memory."""

    def probe(self, process: str, name: str) -> tuple[Array, Array]:
        """Time since the start [s] and value in each cycle; KeyError: there is no such probe."""


def summarise(options: RunOptions, outcome: Outcome, contract: Contract) -> dict[str, Any]:
    """Judge the recording in `options.out` and the nodes' counters."""
    scenario = options.scenario
    from hil.record.reader import open_run  # large libraries: a run in memory does without them

    run = open_run(options.out)
    metrics = control_metrics(
        recorded_truth(run),
        recorded_tracking(run, contract),
        stop_position_m=scenario.journey.destination.position_m,
    )
    counters = Counters(
        deadline_misses={name: _counted(outcome, name, "missed") for name in PROCESSES},
        consecutive_misses={name: _counted(outcome, name, "max_consecutive_misses") for name in PROCESSES},
        frames_lost=frames_lost(outcome),
        e2e_rejected=None if _incomplete(outcome) else sum(row["rejected"] for row in _e2e(outcome).values()),
        cycles_not_recorded=_cycles_not_recorded(outcome),
        interventions=recorded_interventions(run, contract),
    )
    allowed_s = recorded_allowance_s(run, scenario.journey.time_s)
    rows = criteria(
        metrics,
        counters,
        scenario.limits,
        timetable_s=allowed_s,
        real_time=not options.lockstep,
    )
    if scenario.bus.loss_probability > 0.0:  # then a lost frame is no fault of the bus
        rows = [row for row in rows if row.name != "frames_lost"]
    return {
        "scenario": scenario.name,
        "verdict": verdict(rows, ended=outcome.ending.how),
        "ended": outcome.ending.how,
        "ended_because": outcome.ending.because,
        "mode": options.mode,
        "processes": "one" if outcome.one_process else "separate",
        "law": scenario.law,
        "seed": scenario.journey.seed,
        "started": outcome.started,
        "wall_time_s": round(outcome.wall_time_s, 3),
        "simulated_time_s": round(outcome.simulated_time_s, 3),
        "speedup": round(outcome.speedup, 2),
        "criteria": [row.as_dict() for row in rows],
        "control": _control(metrics, scenario.journey.time_s, allowed_s),
        "timing": {name: _timing(run, outcome.nodes.get(name, {}), name) for name in PROCESSES},
        "bus": _bus(options, outcome),
        "environment": environment(),
    }


def recorded_truth(run: Probes) -> Truth:
    """The plant's own account of the train; empty arrays if no plant of ours took part."""
    names = (
        "position_m",
        "speed_mps",
        "acceleration_mps2",
        "permitted_speed_mps",
        "traction_energy_j",
        "regenerated_energy_j",
    )
    try:
        columns = [run.probe("plant_sim", name) for name in names]
    except KeyError:
        return Truth(*(np.empty(0),) * 7)
    return Truth(columns[0][0], *(values for _, values in columns))


def recorded_tracking(run: Probes, contract: Contract) -> Tracking:
    """The reference that the controller followed, in the cycles in which it drove."""
    try:
        time_s, reference = run.probe("controller", "reference_speed_mps")
        chosen = recorded_driving(run, contract)
    except KeyError:
        return Tracking(np.empty(0), np.empty(0))
    return Tracking(time_s[chosen], reference[chosen])


def recorded_allowance_s(run: Probes, timetable_s: float) -> float:
    """What the trip may take from departure [s]: the timetable, less what the train was held at departure.

    It is no less than was possible once others had held or restricted it, as the controller planned.
    """
    try:
        _, allowed = run.probe("controller", "allowed_time_s")
    except KeyError:
        return timetable_s
    return float(allowed[-1]) if len(allowed) and allowed[-1] > 0.0 else timetable_s


def recorded_driving(run: Probes, contract: Contract) -> NDArray[np.bool_]:
    """In which of its cycles the controller drove; KeyError if no controller of ours took part."""
    choices = contract.message("ATO_Command").signal("Mode").choices
    _, mode = run.probe("controller", "mode")
    return np.isin(mode, [number for number, name in choices.items() if name in DRIVING_MODES])


def environment() -> dict[str, Any]:
    """The machine and the versions that a run's numbers belong to."""
    realtime = Path("/sys/kernel/realtime")
    return {
        "python": platform.python_version(),
        "kernel": f"{platform.system()} {platform.release()}",
        "preempt_rt": realtime.exists() and realtime.read_text().strip() == "1",
        "machine": platform.machine(),
        "cpus": os.cpu_count(),
        "packages": {
            name: version(name)
            for name in ("ato-hil", "python-can", "cantools", "numpy", "numba", "rerun-sdk")
        },
    }


def _control(metrics: ControlMetrics, timetable_s: float, allowed_s: float) -> dict[str, Any]:
    trip = metrics.trip_time_s
    return {
        "rms_speed_error_mps": _rounded(metrics.rms_speed_error_mps, 6),
        "max_speed_error_mps": _rounded(metrics.max_speed_error_mps, 6),
        "max_overspeed_mps": _rounded(metrics.max_overspeed_mps, 6),
        "stop_error_m": _rounded(metrics.stop_error_m, 6),
        "max_jerk_mps3": _rounded(metrics.max_jerk_mps3, 4),
        "acceleration_at_standstill_mps2": _rounded(metrics.acceleration_at_standstill_mps2, 4),
        "trip_time_s": _rounded(trip, 3),
        "timetable_s": timetable_s,
        "allowed_time_s": _rounded(allowed_s, 3),
        "trip_time_error_s": _rounded(None if trip is None else trip - allowed_s, 3),
        "traction_energy_j": _rounded(metrics.traction_energy_j, 1),
        "regenerated_energy_j": _rounded(metrics.regenerated_energy_j, 1),
        "energy_at": "wheel rim",  # the trains carry no efficiencies: braking work, not what the line gets
    }


def _timing(run: Run, status: Mapping[str, Any], process: str) -> dict[str, Any]:
    try:
        columns = run.timing(process)
    except KeyError:
        columns = {}
    empty = np.empty(0)
    return {
        "period_s": status.get("period_ns", 0) * 1e-9,
        "cycles": status.get("cycles", 0),
        "missed": status.get("missed", 0),
        "max_consecutive_misses": status.get("max_consecutive_misses", 0),
        "missed_startup": status.get("missed_startup", 0),
        "skipped": status.get("skipped", 0),
        "wakeup_latency_us": percentiles_us(columns.get("wakeup_latency_us", empty)),
        "execution_us": percentiles_us(columns.get("execution_us", empty)),
        "sched_fifo": bool(status.get("sched_fifo", False)),
        "mlock": bool(status.get("mlock", False)),
        "rights": status.get("rights", {}),
        "spin": status.get("spin"),
        "rehearsal": status.get("rehearsal"),
    }


def _bus(options: RunOptions, outcome: Outcome) -> dict[str, Any]:
    return {
        "interface": outcome.bus.interface,
        "channel": outcome.bus.channel,
        "bitrate": outcome.wire.get("bitrate", outcome.bus.bitrate),
        "frames": outcome.recorder.get("frames", 0),
        "load": outcome.wire.get("load"),  # None: nobody measured it
        "dropped": frames_lost(outcome),
        "lost_on_purpose": outcome.lost_on_purpose,
        "e2e": _e2e(outcome),
    }


def frames_lost(outcome: Outcome) -> int | None:
    """Frames that did not arrive: what interfaces report, gaps in E2E counters, and frames that were sent
    but are not on record. None if a process that counted did not end well.
    """
    if _incomplete(outcome):
        return None
    recorder = outcome.recorder
    links = [status["frames"] for status in outcome.nodes.values()]
    reported = outcome.bench_dropped + recorder["dropped"] + sum(link["dropped"] for link in links)
    gaps = sum(row["lost"] for row in _e2e(outcome).values()) + sum(recorder["counter_lost"].values())
    sent = outcome.bench_sent + sum(link["sent"] for link in links)
    return int(reported + gaps + max(0, sent - recorder["frames"]))


def recorded_interventions(run: Probes, contract: Contract) -> int | None:
    """How often the controller's mode became one in which the supervision has taken over."""
    choices = contract.message("ATO_Command").signal("Mode").choices
    taken_over = [number for number, name in choices.items() if name in TAKEN_OVER_MODES]
    try:
        _, mode = run.probe("controller", "mode")
    except KeyError:
        return None
    inside = np.isin(mode, taken_over)
    return int(np.count_nonzero(inside[1:] & ~inside[:-1]) + bool(len(inside) and inside[0]))


def _incomplete(outcome: Outcome) -> bool:
    return not outcome.recorder or any(not outcome.nodes.get(name) for name in PROCESSES)


def _counted(outcome: Outcome, process: str, key: str) -> int | None:
    status = outcome.nodes.get(process)
    return int(status[key]) if status else None


def _cycles_not_recorded(outcome: Outcome) -> int | None:
    if not outcome.recorder:
        return None
    return sum(int(ring["lost"]) for ring in outcome.recorder["rings"].values())


def _e2e(outcome: Outcome) -> dict[str, dict[str, int]]:
    """Counts per protected message, summed over its receivers."""
    rows: dict[str, dict[str, int]] = {}
    for status in outcome.nodes.values():
        for name, counts in status.get("e2e", {}).items():
            row = rows.setdefault(name, {"ok": 0, "rejected": 0, "lost": 0})
            for key in row:
                row[key] += int(counts.get(key, 0))
    return rows


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
