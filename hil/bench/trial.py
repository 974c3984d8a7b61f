"""One trial of a comparison: a contender drives one train, and is judged. Numbers always; lines if wanted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hil.bench.bare import BareRun, bare_run
from hil.bench.chatter import NO_CHATTER_KNOWN, Chatter, chatter, commanded_force_n, ideal_force_n
from hil.bench.contender import Contender
from hil.bench.metrics import Array, ControlMetrics
from hil.bench.outcome import Interrupted
from hil.bench.scenario import Scenario
from hil.bench.sets import Draw
from hil.bench.summary import recorded_driving
from hil.canbus.contract import Contract

NOT_KNOWN = ControlMetrics(*(None,) * 9)


@dataclass(frozen=True)
class Trial:
    """What one run is asked to be."""

    scenario: str
    overrides: tuple[str, ...]
    contender: Contender
    draw: Draw
    keep_lines: bool = False


@dataclass(frozen=True)
class Lines:
    """A run as lines over time, one value per controller cycle (arrays of one length), while it drove."""

    time_s: Array
    position_m: Array
    speed_mps: Array
    reference_speed_mps: Array
    acceleration_mps2: Array
    effort_n: Array
    """Commanded, signed."""

    @property
    def error_mps(self) -> Array:
        """Reference minus true speed."""
        error: Array = self.reference_speed_mps - self.speed_mps
        return error


@dataclass(frozen=True)
class TrialResult:
    """How a run went. `failure` is empty, or says in one line why it is none to count on."""

    contender: Contender
    draw: Draw
    failure: str
    metrics: ControlMetrics = NOT_KNOWN
    chatter: Chatter = NO_CHATTER_KNOWN
    overshoot_percent: float | None = None
    step_us: float | None = None
    """Median time of the controller's whole step: reading, supervision, plan, law."""
    step_p99_us: float | None = None
    wall_s: float = 0.0
    lines: Lines | None = None

    @property
    def came_to_run(self) -> bool:
        """Whether there was a run at all, good or bad."""
        return self.metrics != NOT_KNOWN

    def numbers(self) -> dict[str, Any]:
        """The measured values by name, for JSON and CSV."""
        return {
            **asdict(self.metrics),
            **asdict(self.chatter),
            "overshoot_percent": self.overshoot_percent,
            "step_us": self.step_us,
            "step_p99_us": self.step_p99_us,
        }


def try_out(trial: Trial, contract: Contract, *, interrupted: Interrupted = lambda: 0) -> TrialResult | None:
    """Drive and judge; None if it was interrupted. No error passes: what went wrong is the result."""
    overrides = (*trial.overrides, *trial.contender.overrides(), *trial.draw.overrides())
    try:
        run = bare_run(trial.scenario, overrides, contract, interrupted=interrupted)
        if run.ending.how == "aborted":
            return None
        return judge(trial, run, contract)
    except Exception as error:
        told = str(error) if hasattr(error, "exit_code") else f"{type(error).__name__}: {error}"
        return TrialResult(trial.contender, trial.draw, failure=" ".join(told.split()))


def judge(trial: Trial, run: BareRun, contract: Contract) -> TrialResult:
    """All measures of a run."""
    interventions = run.interventions(contract)
    failure = ""
    if run.ending.how != "arrived":
        failure = run.ending.because
    elif interventions:
        failure = f"the supervision took over {interventions} time{'s' if interventions > 1 else ''}"
    lines = driven_lines(run, contract)
    steps = run.step_us["controller"]
    return TrialResult(
        contender=trial.contender,
        draw=trial.draw,
        failure=failure,
        metrics=run.metrics(contract),
        chatter=_chatter(run, lines, contract),
        overshoot_percent=overshoot_percent(lines),
        step_us=float(np.median(steps)) if len(steps) else None,
        step_p99_us=float(np.percentile(steps, 99)) if len(steps) else None,
        wall_s=run.wall_s,
        lines=lines if trial.keep_lines else None,
    )


def overshoot_percent(lines: Lines) -> float | None:
    """How far the highest speed is above the highest reference [% of it]; 0 if it stays below."""
    if not len(lines.time_s):
        return None
    highest = float(np.max(lines.reference_speed_mps))
    excess = float(np.max(lines.speed_mps)) - highest
    return 100.0 * max(0.0, excess) / highest if highest > 0.0 else None


def driven_lines(run: BareRun, contract: Contract) -> Lines:
    """The run from departure to standstill, at the controller's instants."""
    driving = recorded_driving(run, contract)
    time_s, reference = run.probe("controller", "reference_speed_mps")
    _, demand = run.probe("controller", "effort_demand")
    time_s = time_s[driving]
    train = run.scenario.journey.train
    true = _at(run, time_s)
    return Lines(
        time_s=time_s,
        position_m=true("position_m"),
        speed_mps=true("speed_mps"),
        reference_speed_mps=reference[driving],
        acceleration_mps2=true("acceleration_mps2"),
        effort_n=commanded_force_n(
            demand[driving], true("speed_mps"), train.traction_effort_n, train.service_brake_effort_n()
        ),
    )


def true_effective_mass_kg(scenario: Scenario) -> float:
    """Mass that a force accelerates, of the train as it is: load does not rotate."""
    table: Mapping[str, Any] = scenario.tables["plant"].get("train", {})
    train = scenario.journey.train
    return train.mass_kg * (float(table.get("mass_factor", 1.0)) + train.rotating_mass_factor)


def _chatter(run: BareRun, lines: Lines, contract: Contract) -> Chatter:
    driving = recorded_driving(run, contract)
    _, acceleration = run.probe("controller", "reference_acceleration_mps2")
    resistance_n = _at(run, lines.time_s)("resistance_n")
    ideal_n = ideal_force_n(acceleration[driving], resistance_n, true_effective_mass_kg(run.scenario))
    return chatter(lines.time_s, lines.effort_n, ideal_n)


def _at(run: BareRun, time_s: Array) -> Callable[[str], Array]:
    """A reader of the plant's probes at these times."""

    def read(name: str) -> Array:
        there_s, values = run.probe("plant_sim", name)
        found: Array = np.interp(time_s, there_s, values)
        return found

    return read
