"""The experiment of the fuzzy-PID paper: a point mass on 36.28 km, and a reference of five phases.

The paper prints the line and three constants; its target speeds, train and sample time are not known.
What is chosen here is said in `studies.fuzzy_pid.ASSUMPTIONS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from controller.laws import Law, Measurement, Reference
from controller.laws.fuzzy_pid import FuzzyPid
from hil.railway.library import find_line
from hil.railway.line import Line
from hil.railway.line_file import load_line
from hil.railway.train import DavisCoefficients
from studies.figure import Floats
from studies.train_plant import TrainData, TrainPlant

__all__ = ["CLIMB_M", "DATA", "SAMPLE_S", "Plan", "Run", "drive", "plan", "sensitivity_peak"]

SAMPLE_S = 0.1
CLEAR_M = 200.0
"""25 m/s hold this far before and behind the climb: its ends are met at constant speed."""
CLIMB_M = (12_000.0, 21_680.0)
STOP_M = 36_280.0
CRUISE_MPS, CLIMB_MPS = 30.0, 25.0
TARGETS_MPS = (CRUISE_MPS, CLIMB_MPS, CRUISE_MPS, 0.0)
PLANNED_ACCELERATION, PLANNED_BRAKING, PLANNED_JERK = 0.6, 0.8, 0.5
EASING = 0.3
"""Deceleration to the climb [m/s2]: hardly more than running resistance alone."""
BRAKING_MPS2 = (PLANNED_BRAKING, EASING, EASING, PLANNED_BRAKING)
PLANNED_POWER_SHARE = 0.8
QUANTUM_MPS = 0.01 / 3.6

DATA = TrainData(
    # (0.0015 V^2 + 0.27 V + 215)/1000 m/s2, V in km/h
    davis_mps2=DavisCoefficients(0.215, 0.27e-3 * 3.6, 0.0015e-3 * 3.6 * 3.6),
    max_acceleration_mps2=0.9,
    max_power_w_per_kg=16.0,
    max_braking_mps2=1.1,
    dead_time_s=0.2,
    lag_s=0.6,
)


class Plan(NamedTuple):
    """Reference over time, one value every `SAMPLE_S` (n)."""

    time_s: Floats
    position_m: Floats
    speed_mps: Floats
    acceleration_mps2: Floats


def plan(line: Line | None = None) -> Plan:
    """Start, 30 m/s, 25 m/s on the climb, 30 m/s, stop: jerk-limited, within the power there is."""
    line = line or load_line(find_line("mainline_36km"))
    inner = 0.01
    t = x = v = a = 0.0
    phase = 0
    rows = [(t, x, v, a)]
    every = round(SAMPLE_S / inner)
    for k in range(1, round(3000.0 / inner)):
        phase += _phase_ends(phase, x, v)
        wanted = TARGETS_MPS[phase]
        if wanted > v:
            specific = line.mean_specific_resistance(x) * 9.81e-3
            power = DATA.max_power_w_per_kg * PLANNED_POWER_SHARE / max(v, 1.0)
            most = power - DATA.davis_mps2.resistance_n(v) - specific
            aim = min(PLANNED_ACCELERATION, most, math.sqrt(2.0 * PLANNED_JERK * (wanted - v)))
        else:
            aim = -min(BRAKING_MPS2[phase], math.sqrt(2.0 * PLANNED_JERK * (v - wanted)))
        a += min(max(aim - a, -PLANNED_JERK * inner), PLANNED_JERK * inner)
        moved = max(0.0, v + a * inner)
        x += inner * 0.5 * (v + moved)
        v, t = moved, k * inner
        if k % every == 0:
            rows.append((t, x, v, a))
        if x > 1000.0 and v <= 1e-3:
            break
    time_s, position, speed, acceleration = np.array(rows, dtype=np.float64).T.copy()
    return Plan(time_s, position, speed, acceleration)


def _phase_ends(phase: int, position_m: float, speed_mps: float) -> bool:
    """Whether the next target speed begins here; a braking that has begun is never taken back."""
    match phase:
        case 0:
            return position_m >= CLIMB_M[0] - CLEAR_M - _braking_m(speed_mps, CLIMB_MPS, EASING)
        case 1:
            return position_m >= CLIMB_M[1] + CLEAR_M
        case 2:
            return position_m >= STOP_M - _braking_m(speed_mps, 0.0, PLANNED_BRAKING)
        case _:
            return False


def _braking_m(speed_mps: float, to_mps: float, braking_mps2: float) -> float:
    change = max(0.0, speed_mps - to_mps)
    if change == 0.0:
        return 0.0
    plateau = min(braking_mps2, math.sqrt(PLANNED_JERK * change))
    hold = max(0.0, (change - plateau**2 / PLANNED_JERK) / plateau)
    return 0.5 * (speed_mps + to_mps) * (2.0 * plateau / PLANNED_JERK + hold)


class Run(NamedTuple):
    """One value for each sample (n); the error is reference minus true speed.

    `gains` (n, 3) are kp, ki, kd of a fuzzy PID, NaN of any other law.
    """

    time_s: Floats
    position_m: Floats
    speed_mps: Floats
    reference_mps: Floats
    error_mps: Floats
    command_mps2: Floats
    gains: Floats

    @property
    def rms_mps(self) -> float:
        """RMS of the speed error."""
        return float(np.sqrt(np.mean(self.error_mps**2)))

    @property
    def max_mps(self) -> float:
        """Largest speed error."""
        return float(np.max(np.abs(self.error_mps)))

    @property
    def max_at_edges_mps(self) -> float:
        """Largest speed error in the 20 s after the front passes an end of the climb."""
        worst = 0.0
        for edge in CLIMB_M:
            start = self.time_s[np.argmax(self.position_m >= edge)]
            near = (self.time_s >= start) & (self.time_s <= start + 20.0)
            worst = max(worst, float(np.max(np.abs(self.error_mps[near]))))
        return worst


def drive(
    law: Law,
    reference: Plan,
    *,
    feed_forward: bool,
    line: Line | None = None,
    watch: Callable[[float], None] | None = None,
) -> Run:
    """Track the plan in time. With `feed_forward` planned acceleration, resistance and track are added."""
    law.reset()
    line = line or load_line(find_line("mainline_36km"))
    plant = TrainPlant(DATA, line, step_s=SAMPLE_S)
    times = reference.time_s.tolist()
    speeds = reference.speed_mps.tolist()
    planned = reference.acceleration_mps2.tolist()
    rows = np.empty((len(times), 6))
    gains = np.full((len(times), 3), np.nan)
    for k, (t, wanted) in enumerate(zip(times, speeds, strict=True)):
        measured = round(plant.speed_mps / QUANTUM_MPS) * QUANTUM_MPS
        resistance = plant.resistance_mps2(plant.position_m, measured) if feed_forward else 0.0
        demand = law.step(
            Reference(plant.position_m, wanted, planned[k], planned[k] if feed_forward else 0.0),
            Measurement(
                plant.position_m,
                measured,
                -DATA.max_braking_mps2 - resistance,
                DATA.traction_mps2(measured) - resistance,
                resistance,
            ),
            SAMPLE_S,
        )
        command = demand + resistance
        error = wanted - plant.speed_mps
        rows[k] = t, plant.position_m, plant.speed_mps, wanted, error, command
        if isinstance(law, FuzzyPid):
            gains[k] = law.gains
        plant.advance(command)
        if watch is not None and k % 500 == 0:
            watch(k / len(times))
    time_s, x, v, r, e, u = rows.T.copy()
    return Run(time_s, x, v, r, e, u, gains)


def sensitivity_peak(gains: Floats, derivative_filter_per_s: float) -> float:
    """Ms, the largest over frozen gains (n, 3) of max |1/(1 + L)|; up to 2 is robust, infinite if unstable.

    L: PID with filtered derivative, dead time and half a sample of hold, lag, and the integration to speed.
    """
    w = np.geomspace(0.02, np.pi / SAMPLE_S, 600)
    s = 1j * w
    delay = DATA.dead_time_s + 0.5 * SAMPLE_S
    plant = np.exp(-s * delay) / (s * (DATA.lag_s * s + 1.0))
    kp, ki, kd = (column[:, None] for column in np.atleast_2d(gains).T)
    n = derivative_filter_per_s
    loop = (kp + ki / s + kd * s * n / (s + n)) * plant
    peak = float(np.max(1.0 / np.abs(1.0 + loop)))
    # Stable if the phase at the last crossing of |L| = 1 has not passed -180 degrees.
    phase = np.unwrap(np.angle(loop), axis=1)
    over = np.abs(loop) >= 1.0
    last = loop.shape[1] - 1 - np.argmax(over[:, ::-1], axis=1)
    crossing = phase[np.arange(len(phase)), last]
    return math.inf if bool(np.any(crossing < -math.pi)) else peak
