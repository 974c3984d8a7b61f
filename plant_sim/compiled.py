"""The compiled motion: `dynamics.Dynamics` with its loop in `kernel`, one call a cycle."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hil.railway.resistance import GRAVITY_MPS2
from hil.railway.train import EffortCurve
from plant_sim.dynamics import Orders, delay_substeps
from plant_sim.kernel import advance
from plant_sim.vehicle import (
    BLOCKED_LAG_S,
    PROMPT_RATE_FACTOR,
    PULSES_OFF_S,
    RATE_LOOP_S,
    SLIDE_MARGIN_N,
    FloatArray,
    Vehicle,
)


class Motion(NamedTuple):
    """State and forces after a cycle, as plain numbers; the first ten and `time_s` are `dynamics.State`."""

    position_m: float
    speed_mps: float
    drive_limited_n: float
    drive_n: float
    pneumatic_limited_n: float
    pneumatic_n: float
    traction_work_j: float
    electrodynamic_work_j: float
    pneumatic_work_j: float
    resistance_work_j: float
    acceleration_mps2: float
    traction_effort_n: float  # from here on: what reaches the rail
    electrodynamic_effort_n: float
    pneumatic_effort_n: float
    resistance_n: float
    slips: float
    slides: float
    time_s: float
    delay_head: int


_PARAMETERS = (
    "substep_s", "length_m", "effective_mass_kg", "weight_n", "davis_a_n", "davis_b", "davis_c", "starting_n",
    "traction_max_n", "traction_power_w", "traction_lag_s", "traction_rate", "traction_factor",
    "electrodynamic_max_n", "electrodynamic_power_w", "electrodynamic_lag_s", "electrodynamic_rate",
    "fade_start_mps", "fade_end_mps", "service_effort_n", "max_braking_mps2", "brake_factor",
    "pneumatic_lag_s", "adhesion", "motored", "rate_loop_s", "prompt_rate_factor", "blocked_lag_s",
    "pulses_off_s", "slide_margin_n", "friction_factor", "disturbance_n", "disturbance_radps",
    "disturbance_rad",
)  # fmt: skip
STATE = np.dtype([(n, np.int64 if n == "delay_head" else np.float64) for n in Motion._fields])
PARAMETERS = np.dtype(
    [(name, np.float64) for name in _PARAMETERS]
    + [(name, np.int64) for name in ("traction_delay", "electrodynamic_delay", "pneumatic_delay")]
)


class KernelDynamics:
    """Same as `dynamics.Dynamics`, compiled."""

    def __init__(self, vehicle: Vehicle, position_m: float, substep_s: float, pneumatic_n: float) -> None:
        self.vehicle = vehicle
        self._parameters = _parameters(vehicle, substep_s)
        self._state = np.zeros(1, dtype=STATE)
        self._state["position_m"] = position_m
        self._state["pneumatic_n"] = self._state["pneumatic_limited_n"] = pneumatic_n
        record = self._parameters[0]
        delays = [int(record[f"{name}_delay"]) for name in ("traction", "electrodynamic", "pneumatic")]
        self._lines = np.zeros((2, max(delays) + 1))  # row 0 demand, row 1 friction brake order
        self._lines[1] = pneumatic_n
        gradient, friction = vehicle.gradient_and_friction()
        self._track = np.vstack(
            [
                gradient.edges_m,
                gradient.integral_m,
                friction.integral_m,
                np.append(gradient.specific_n_per_kn, 0.0),
                np.append(friction.specific_n_per_kn, 0.0),
            ]
        )
        self._curves = (_points(vehicle.train.traction.curve), _points(vehicle.train.electrodynamic.curve))

    def advance(self, orders: Orders, substeps: int) -> Motion:
        """Integrate with constant orders; state and forces at the end."""
        advance(
            self._state, self._parameters, self._lines, self._track, self._curves[0], self._curves[1],
            float(orders.demand), orders.drive_enabled, float(orders.pneumatic_n), orders.prompt, substeps,
        )  # fmt: skip
        return Motion(*self._state[0].item())

    @property
    def motion(self) -> Motion:
        """State and forces after the last `advance`."""
        return Motion(*self._state[0].item())

    def warm_up(self) -> None:
        """Compile the kernel (or load it from its cache) without a side effect."""
        saved = self._state.copy(), self._lines.copy()
        for demand in (0.5, -0.5):
            self.advance(Orders(demand, True, 0.0, False), 1)
        self._state[:], self._lines[:] = saved


def _points(curve: EffortCurve) -> FloatArray:
    return np.array(curve.points, dtype=np.float64).reshape(-1, 2)


def _parameters(vehicle: Vehicle, substep_s: float) -> np.ndarray[Any, Any]:
    train, deviations = vehicle.train, vehicle.deviations
    drive, brake, friction = train.traction, train.electrodynamic, train.pneumatic
    lag, dead = deviations.time_constant_factor, deviations.dead_time_factor
    weight_n = vehicle.mass_kg * GRAVITY_MPS2
    values: dict[str, float] = {
        "substep_s": substep_s,
        "length_m": vehicle.length_m,
        "effective_mass_kg": vehicle.effective_mass_kg,
        "weight_n": weight_n,
        "davis_a_n": train.davis.a_n * deviations.davis_factor,
        "davis_b": train.davis.b_n_per_mps * deviations.davis_factor,
        "davis_c": train.davis.c_n_per_mps2 * deviations.davis_factor,
        "starting_n": train.starting_resistance_n_per_kn * 1e-3 * weight_n,
        "traction_max_n": drive.curve.max_effort_n,
        "traction_power_w": np.inf if drive.curve.max_power_w is None else drive.curve.max_power_w,
        "traction_lag_s": drive.time_constant_s * lag,
        "traction_rate": drive.jerk_limit_mps3 * train.effective_mass_kg,
        "traction_factor": deviations.traction_factor,
        "electrodynamic_max_n": brake.curve.max_effort_n,
        "electrodynamic_power_w": np.inf if brake.curve.max_power_w is None else brake.curve.max_power_w,
        "electrodynamic_lag_s": brake.time_constant_s * lag,
        "electrodynamic_rate": brake.jerk_limit_mps3 * train.effective_mass_kg,
        "fade_start_mps": brake.fade_start_mps,
        "fade_end_mps": brake.fade_end_mps,
        "service_effort_n": train.service_brake_effort_n(),
        "max_braking_mps2": train.max_braking_mps2,
        "brake_factor": deviations.brake_factor,
        "friction_factor": deviations.brake_factor * deviations.friction_brake_factor,
        "pneumatic_lag_s": friction.time_constant_s * deviations.friction_time_constant_factor,
        "adhesion": deviations.adhesion,
        "rate_loop_s": RATE_LOOP_S,
        "prompt_rate_factor": PROMPT_RATE_FACTOR,
        "blocked_lag_s": BLOCKED_LAG_S,
        "pulses_off_s": PULSES_OFF_S,
        "slide_margin_n": SLIDE_MARGIN_N,
        "disturbance_n": vehicle.effective_mass_kg * vehicle.disturbance.amplitude_mps2,
        "disturbance_radps": vehicle.disturbance.angular_frequency_radps,
        "disturbance_rad": vehicle.disturbance.phase_rad,
        "motored": train.powered_mass_fraction,
        "traction_delay": delay_substeps(drive.dead_time_s * dead, substep_s),
        "electrodynamic_delay": delay_substeps(brake.dead_time_s * dead, substep_s),
        "pneumatic_delay": delay_substeps(friction.dead_time_s * dead, substep_s),
    }
    parameters = np.zeros(1, dtype=PARAMETERS)
    for name, value in values.items():
        parameters[0][name] = value
    return parameters
