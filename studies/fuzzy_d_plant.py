"""The experiment of the Fuzzy-D paper: its identified plant, its line, its reference (section 4).

The plant is equation 4, `w' = 612 u - 0.34 w`, `8621 v' = w - Fc - 822.4 v`, in Euler steps of 1 ms or less.
The laws run with the paper's gains as printed, so what they demand here is its control u and no acceleration;
612/0.34/8621 u = 0.2088 u [m/s2] is what a steady u is worth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controller.laws import Law, Measurement, Reference
from hil.railway.resistance import curve_n_per_kn, specific_to_n
from studies.figure import Floats

__all__ = [
    "CURVE_END_M",
    "CURVE_MPS",
    "CURVE_START_M",
    "GAIN",
    "LIMIT_MPS",
    "RAMP_M",
    "STOP_M",
    "Headline",
    "Run",
    "additional_resistance_n_per_kn",
    "drive",
    "headline",
    "reference_speed",
]

GAIN, DECAY_PER_S, MASS_KG, DRAG_N_PER_MPS = 612.0, 0.34, 8621.0, 822.4

LIMIT_MPS, CURVE_MPS = 15.0, 10.5
CURVE_START_M, CURVE_END_M, STOP_M = 1000.0, 1500.0, 2000.0

RAMP_M = 6.49
"""Length of the reference's ramps. The paper does not give it; this one fits its stop errors."""


def reference_speed(position_m: float, ramp_m: float = RAMP_M, early_m: float = 0.0) -> tuple[float, float]:
    """Reference speed [m/s] and its slope [1/s] at a position: near-steps, by position.

    The ramps down end where the lower speed begins to hold, or `early_m` before; up they begin there.

    The paper's distances (30, 12, 4.5 m to full speed; 30, 4.5, 1 m at the stop) leave no other reading: a
    schedule in time would give stop errors in the opposite order.
    """
    steps = (
        (CURVE_START_M - ramp_m - early_m, LIMIT_MPS, CURVE_MPS),
        (CURVE_END_M, CURVE_MPS, LIMIT_MPS),
        (STOP_M - ramp_m - early_m, LIMIT_MPS, 0.0),
    )
    speed, slope = LIMIT_MPS, 0.0
    for start_m, before, after in steps:
        if position_m < start_m:
            break
        if ramp_m > 0.0 and position_m < start_m + ramp_m:
            slope = (after - before) / ramp_m
            return before + slope * (position_m - start_m), slope
        speed = after
    return speed, slope


def additional_resistance_n_per_kn(position_m: float) -> float:
    """Gradient and curve of the paper's line (its Fig. 11), N/kN: 6 permille up, R = 500 m, 6 down."""
    gradient = 6.0 if 200.0 <= position_m < 400.0 else -6.0 if 1100.0 <= position_m < 1300.0 else 0.0
    curve = curve_n_per_kn(500.0) if CURVE_START_M <= position_m < CURVE_END_M else 0.0
    return gradient + curve


class Run(NamedTuple):
    """What happened: one value for each step (n). Position in m, speeds in m/s, control in the paper's u."""

    time_s: Floats
    position_m: Floats
    speed_mps: Floats
    reference_mps: Floats
    control: Floats
    acceleration_mps2: Floats


def drive(
    law: Law,
    step_s: float,
    *,
    ramp_m: float = RAMP_M,
    after_s: float = 6.0,
    longest_s: float = 260.0,
    end_m: float = math.inf,
    watch: Callable[[float], None] | None = None,
) -> Run:
    """Drive the 2 km with a law in the paper's units, unsaturated; ends `after_s` after standstill.

    `end_m` ends the drive at that position, for parts of it. `watch` hears the position, once a second.
    """
    law.reset()
    force, speed, position = 0.0, 0.0, 0.0
    rows: list[tuple[float, float, float, float, float]] = []
    last = int(longest_s / step_s)
    second = max(1, round(1.0 / step_s))
    # Gradient and curve are piecewise constant: computed when the train has moved on by a metre.
    metre, resistance = -math.inf, 0.0
    k = 0
    while k <= last and position < end_m:
        if position - metre >= 1.0:
            metre = math.floor(position)
            resistance = specific_to_n(additional_resistance_n_per_kn(position), MASS_KG)
        wanted, slope = reference_speed(position, ramp_m)
        acceleration = (force - resistance - DRAG_N_PER_MPS * speed) / MASS_KG
        control = law.step(
            Reference(position, wanted, slope * speed, 0.0),
            Measurement(position, speed, -math.inf, math.inf, acceleration_mps2=acceleration),
            step_s,
        )
        rows.append((position, speed, wanted, control, acceleration))
        force += step_s * (GAIN * control - DECAY_PER_S * force)
        moved = speed + step_s * acceleration
        position += step_s * 0.5 * (speed + moved)
        if moved <= 1e-3 and position > STOP_M - ramp_m and last > k + after_s / step_s:
            last = k + round(after_s / step_s)
        speed = moved
        k += 1
        if watch is not None and k % second == 0:
            watch(position)
    columns = np.array(rows, dtype=np.float64).T.copy()
    x, v, reference, control, a = columns
    time_s: Floats = np.arange(len(rows), dtype=np.float64) * step_s
    return Run(time_s, x, v, reference, control, a)


@dataclass(frozen=True)
class Headline:
    """The numbers of section 4 for one controller."""

    overshoot_percent: float
    """Of 15 m/s, before the curve; negative where the speed stays below."""
    reach_m: float
    """Where 98 % of the controller's own steady speed is reached."""
    static_error_mps: float
    """15 m/s less the speed at 950 m."""
    stop_error_m: float
    """Position at the first standstill (or the farthest one, where the train only creeps) less 2000 m."""
    peak_control: float
    peak_acceleration_mps2: float
    peak_jerk_mps3: float


def headline(run: Run) -> Headline:
    """The numbers of a finished drive."""
    start = run.position_m < CURVE_START_M - RAMP_M - 3.5
    steady = float(np.interp(950.0, run.position_m[start], run.speed_mps[start]))
    reached = int(np.argmax(run.speed_mps >= 0.98 * steady))
    first = run.position_m < 100.0
    stopping = np.nonzero((run.position_m > STOP_M - 20.0) & (run.speed_mps <= 0.0))[0]
    stopped = run.position_m[stopping[0]] if len(stopping) else np.max(run.position_m)
    step_s = float(run.time_s[1] - run.time_s[0])
    return Headline(
        overshoot_percent=100.0 * (float(np.max(run.speed_mps[start])) / LIMIT_MPS - 1.0),
        reach_m=float(run.position_m[reached]),
        static_error_mps=LIMIT_MPS - steady,
        stop_error_m=float(stopped) - STOP_M,
        peak_control=float(np.max(np.abs(run.control[first]))),
        peak_acceleration_mps2=float(np.max(np.abs(run.acceleration_mps2[first]))),
        peak_jerk_mps3=float(np.max(np.abs(np.diff(run.acceleration_mps2[first])))) / step_s,
    )
