"""What the controllers of the Fuzzy-D paper do on a train: 160 t, 8 x 190 kW, a drive with lag and limits.

The gains are the paper's in acceleration units. Nothing else is changed: no feed-forward, the reference by
position with its near-steps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controller.laws import Law, Measurement, Reference
from hil.railway.library import find_line, find_train
from hil.railway.line_file import load_line
from hil.railway.train import DavisCoefficients, Train
from hil.railway.train_file import load_train
from studies.figure import Floats
from studies.fuzzy_d_plant import LIMIT_MPS, RAMP_M, STOP_M, reference_speed
from studies.train_plant import TrainData, TrainPlant

__all__ = ["TrainRun", "braking_distance_m", "drive_train", "launch", "train_data"]

STEP_S = 0.01


class TrainRun(NamedTuple):
    """One value for each control step (n)."""

    time_s: Floats
    position_m: Floats
    speed_mps: Floats
    reference_mps: Floats
    command_mps2: Floats
    acceleration_mps2: Floats

    @property
    def overshoot_percent(self) -> float:
        """Of 15 m/s, before the curve."""
        before = self.position_m < 880.0
        return 100.0 * (float(np.max(self.speed_mps[before])) / LIMIT_MPS - 1.0)

    @property
    def stop_error_m(self) -> float:
        """Last position less 2000 m."""
        return float(self.position_m[-1]) - STOP_M

    @property
    def sign_changes(self) -> int:
        """How often the command changes between traction and braking."""
        signs = np.sign(self.command_mps2[self.command_mps2 != 0.0])
        return int(np.count_nonzero(np.diff(signs)))

    def reach_m(self, speed_mps: float) -> float:
        """Where this speed is reached first; NaN if never."""
        reached = np.nonzero(self.speed_mps >= speed_mps)[0]
        return float(self.position_m[reached[0]]) if len(reached) else math.nan


def train_data(train: Train | None = None, *, power_w: float | None = None) -> TrainData:
    """The limits of the shipped four-car train, or of another one; `power_w` instead of its own."""
    train = train or load_train(find_train("urban_4car_80m"))
    mass, davis, drive = train.effective_mass_kg, train.davis, train.traction
    power = power_w or drive.curve.max_power_w or math.inf
    return TrainData(
        davis_mps2=DavisCoefficients(davis.a_n / mass, davis.b_n_per_mps / mass, davis.c_n_per_mps2 / mass),
        max_acceleration_mps2=drive.curve.max_effort_n / mass,
        max_power_w_per_kg=power / mass,
        max_braking_mps2=train.max_braking_mps2,
        dead_time_s=drive.dead_time_s,
        lag_s=drive.time_constant_s,
        jerk_mps3=drive.jerk_limit_mps3,
        gravity_share=train.mass_kg / mass,
        length_m=train.length_m,
    )


def drive_train(law: Law, *, anti_windup: bool = True, early_m: float = 0.0) -> TrainRun:
    """Drive the 2 km with a law at 100 Hz until standstill (or 300 s).

    Without `anti_windup` the law is not told what the drive can do. `early_m`: the reference changes that
    much before the curve and the stop.
    """
    law.reset()
    data = train_data()
    plant = TrainPlant(data, load_line(find_line("fuzzy_d_2km")), step_s=STEP_S)
    rows: list[tuple[float, float, float, float, float]] = []
    while len(rows) * STEP_S < 300.0:
        wanted, slope = reference_speed(plant.position_m, RAMP_M, early_m)
        lowest, highest = -math.inf, math.inf
        if anti_windup:
            lowest, highest = -data.max_braking_mps2, data.traction_mps2(plant.speed_mps)
        demand = law.step(
            Reference(plant.position_m, wanted, slope * plant.speed_mps, 0.0),
            Measurement(
                plant.position_m,
                plant.speed_mps,
                lowest,
                highest,
                acceleration_mps2=plant.acceleration_mps2,
            ),
            STEP_S,
        )
        rows.append((plant.position_m, plant.speed_mps, wanted, demand, plant.acceleration_mps2))
        plant.advance(demand)
        if plant.speed_mps <= 1e-3 and wanted == 0.0:
            break
    columns = np.array(rows, dtype=np.float64).T.copy()
    position, speed, reference, command, acceleration = columns
    time_s: Floats = np.arange(len(rows), dtype=np.float64) * STEP_S
    return TrainRun(time_s, position, speed, reference, command, acceleration)


def launch(data: TrainData, speed_mps: float = LIMIT_MPS) -> tuple[float, float]:
    """Time [s] and distance [m] to a speed on level track with all the traction there is; inf if never."""
    plant = TrainPlant(data, None, step_s=STEP_S)
    for k in range(round(300.0 / STEP_S)):
        if plant.speed_mps >= speed_mps:
            return k * STEP_S, plant.position_m
        plant.advance(math.inf)
    return math.inf, math.inf


def braking_distance_m(speed_mps: float, braking_mps2: float, jerk_mps3: float) -> float:
    """Distance [m] to standstill with a deceleration that rises and falls with a jerk limit."""
    plateau = min(braking_mps2, math.sqrt(jerk_mps3 * speed_mps))
    ramp = plateau / jerk_mps3
    hold = max(0.0, (speed_mps - plateau * ramp) / plateau)
    return 0.5 * speed_mps * (2.0 * ramp + hold)
