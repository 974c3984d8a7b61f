"""The experiment of the FSMC paper: its train, its reference (equation 44), and the same loop over a bus.

The plant is equation 11, `v' = (u - w(v))/M + d(t)`. Our laws demand an acceleration; the force is
`u = M_hat demand + w(v)`, which is equations 16, 21 and 34 with everything that is not resistance in the law.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controller.laws import Law, Measurement, Reference
from hil.railway.resistance import davis_n
from studies.figure import Floats

__all__ = [
    "BRAKE_N",
    "DISTURBED",
    "DURATION_S",
    "NOMINAL",
    "SAMPLE_S",
    "TRACTION_N",
    "Bus",
    "Case",
    "Run",
    "drive",
    "ideal_force_n",
    "reference_acceleration",
    "reference_speed",
    "resistance_n",
]

DAVIS = (8547.0, 64.2, 2.2452)
"""N, N/(m/s), N/(m/s)^2: the paper's equation 2 says m/s, its force peak confirms it (its kN is wrong)."""

TRACTION_N, BRAKE_N = 403e3, 380e3
DURATION_S = 90.0
SAMPLE_S = 0.01
KMH = 1.0 / 3.6


def resistance_n(speed_mps: float) -> float:
    """Running resistance w(v) [N], equation 7."""
    return davis_n(speed_mps, *DAVIS)


def reference_speed(time_s: float) -> float:
    """Equation 44, in m/s."""
    slow = 66.558 * math.sin(0.03295 * time_s + 0.19477509)
    fast = 21.77 * math.sin(0.10525195 * time_s - 0.686)
    return (slow + fast + 0.9081385) * KMH


def reference_acceleration(time_s: float) -> float:
    """Derivative of equation 44 [m/s2]."""
    slow = 66.558 * 0.03295 * math.cos(0.03295 * time_s + 0.19477509)
    fast = 21.77 * 0.10525195 * math.cos(0.10525195 * time_s - 0.686)
    return (slow + fast) * KMH


@dataclass(frozen=True)
class Case:
    """The train as it is: mass [kg], and the amplitude [m/s2] of the disturbance d(t) = D sin t."""

    name: str
    mass_kg: float
    disturbance_mps2: float


NOMINAL = Case("nominal", 252_500.0, 0.0)
DISTURBED = Case("disturbed", 305_000.0, 0.1)


@dataclass(frozen=True)
class Bus:
    """What lies between law and train on a bus: steps of the speed, samples of delay, lag of the drive."""

    quantum_mps: float = 0.01 * KMH
    delay_samples: int = 1
    lag_s: float = 0.2
    traction_n: float = TRACTION_N
    brake_n: float = BRAKE_N


class Run(NamedTuple):
    """One value for each sample (n): true speed error in m/s, command in N."""

    time_s: Floats
    speed_mps: Floats
    reference_mps: Floats
    error_mps: Floats
    measured_mps: Floats
    """Speed as the law saw it."""
    command_n: Floats
    ideal_n: Floats
    """What would follow the reference exactly: inverse dynamics of the true train."""


def ideal_force_n(case: Case, time_s: float) -> float:
    """Force [N] that keeps the true train on the reference exactly."""
    disturbance = case.disturbance_mps2 * math.sin(time_s)
    return case.mass_kg * (reference_acceleration(time_s) - disturbance) + resistance_n(
        reference_speed(time_s)
    )


def drive(
    law: Law,
    mass_estimate_kg: float,
    case: Case,
    *,
    bus: Bus | None = None,
    preview_s: float = 0.0,
    derivative_block: bool = False,
    step_s: float = SAMPLE_S,
    duration_s: float = DURATION_S,
    substeps: int = 10,
    watch: Callable[[float], None] | None = None,
) -> Run:
    """Drive the reference once.

    Without a `bus`: the paper's loop, one Euler step a sample, unlimited force. With `derivative_block` the
    reference's acceleration is a backward difference whose first output is zero, as the `d/dt` block of the
    paper's diagrams gives it. With a `bus`: `substeps` steps of the plant a sample, force limited.
    """
    law.reset()
    speed, force = 0.0, 0.0
    delayed = [0.0] * (bus.delay_samples if bus else 0)
    before = math.nan
    steps = round(duration_s / step_s)
    rows = np.empty((steps, 7))
    inner = step_s / substeps
    blend = 1.0 - math.exp(-inner / bus.lag_s) if bus else 1.0
    for k in range(steps):
        t = k * step_s
        wanted, slope = reference_speed(t), reference_acceleration(t)
        if derivative_block:
            slope, before = (0.0 if k == 0 else (wanted - before) / step_s), wanted
        measured, lowest, highest = speed, -math.inf, math.inf
        if bus:
            delayed.append(round(speed / bus.quantum_mps) * bus.quantum_mps)
            measured = delayed.pop(0)
        resistance = resistance_n(measured)
        if bus:
            lowest = (-bus.brake_n - resistance) / mass_estimate_kg
            highest = (bus.traction_n - resistance) / mass_estimate_kg
        preview = reference_acceleration(t + preview_s)
        demand = law.step(
            Reference(0.0, wanted, slope, preview),
            Measurement(0.0, measured, lowest, highest, resistance / mass_estimate_kg),
            step_s,
        )
        command = mass_estimate_kg * demand + resistance
        rows[k] = t, speed, wanted, speed - wanted, measured, command, ideal_force_n(case, t)
        if bus:
            for n in range(substeps):
                force += blend * (command - force)
                disturbance = case.disturbance_mps2 * math.sin(t + n * inner)
                speed += inner * ((force - resistance_n(speed)) / case.mass_kg + disturbance)
        else:
            disturbance = case.disturbance_mps2 * math.sin(t)
            speed += step_s * ((command - resistance_n(speed)) / case.mass_kg + disturbance)
        if watch is not None and k % 500 == 0:
            watch(k / steps)
    time_s, v, reference, error, measured_v, u, ideal = rows.T.copy()
    return Run(time_s, v, reference, error, measured_v, u, ideal)
