"""A speed-profile problem as plain arrays per kilogram of effective mass: what the compiled solvers read."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from controller.profile.problem import Efforts, Problem
from controller.profile.profile import Floats
from hil.railway import GRAVITY_MPS2

NO_LIMIT, HYPERBOLA, TABLE = 0, 1, 2
"""How an effort depends on the speed."""
TABLE_STEP_MPS = 0.025
SMOOTHING_STEPS = 2
"""Corners of an effort table are rounded over this many steps to either side, from below."""


class Effort(NamedTuple):
    """Largest force per mass [N/kg]: `force`, and beside it a function of the speed.

    `kind` is NO_LIMIT, HYPERBOLA (`power` [W/kg] over speed) or TABLE (`table` in steps of TABLE_STEP_MPS).
    """

    force: float
    kind: int
    power: float
    table: Floats


class Stages(NamedTuple):
    """Force per mass of stage k: a + c0[k] + c1 (v0 + v1)/2 + c2 (y0 + y1), with a = (y1 - y0)/dx[k].

    Shapes: `dx`, `c0` (N); `top` (N+1) the limit of y = v^2/2 at the nodes. `friction` is False where the
    regenerative brake is the only one; `brake` limits all brakes together.
    """

    dx: Floats
    c0: Floats
    c1: float
    c2: float
    top: Floats
    start: float
    end: float
    accelerate: float
    decelerate: float
    traction: Effort
    regeneration: Effort
    brake: float
    friction: bool
    traction_cost: float
    regeneration_gain: float


def stages_of(problem: Problem) -> Stages:
    """Arrays of a problem."""
    mass, davis = float(problem.effective_mass_kg), problem.davis
    top_mps = float(np.max(problem.speed_limit_mps))
    weight = problem.mass_kg * GRAVITY_MPS2 * 1e-3
    # floats throughout: an int would be another type, and compile everything again
    return Stages(
        dx=np.diff(problem.position_m.astype(np.float64)),
        c0=(davis.a_n + weight * problem.track_n_per_kn) / mass,
        c1=davis.b_n_per_mps / mass,
        c2=davis.c_n_per_mps2 / mass,
        top=0.5 * problem.node_limit_mps.astype(np.float64) ** 2,
        start=0.5 * float(problem.start_speed_mps) ** 2,
        end=0.5 * float(problem.end_speed_mps) ** 2,
        accelerate=float(problem.max_acceleration_mps2),
        decelerate=float(problem.max_deceleration_mps2),
        traction=_effort(problem.traction, mass, top_mps),
        regeneration=_effort(problem.braking, mass, top_mps),
        brake=np.inf if problem.max_braking_n is None else problem.max_braking_n / mass,
        friction=bool(problem.pneumatic),
        traction_cost=1.0 / problem.traction_efficiency,
        regeneration_gain=float(problem.regeneration_efficiency),
    )


def _effort(efforts: Efforts, mass_kg: float, top_mps: float) -> Effort:
    force = np.inf if efforts.max_force_n is None else efforts.max_force_n / mass_kg
    power = 0.0 if efforts.max_power_w is None else efforts.max_power_w / mass_kg
    if not efforts.points:
        reached = efforts.max_power_w is not None and power < force * top_mps
        return Effort(force, HYPERBOLA if reached else NO_LIMIT, power, np.zeros(2))
    n = SMOOTHING_STEPS
    speeds = np.arange(-2 * n, int(np.ceil(top_mps / TABLE_STEP_MPS)) + 2 * n + 3) * TABLE_STEP_MPS
    exact = efforts.force_n(np.maximum(speeds, 0.0)) / mass_kg
    # the least over a window, then its mean over the same window: smooth, and nowhere above the table
    windows = np.lib.stride_tricks.sliding_window_view
    smooth = windows(windows(exact, 2 * n + 1).min(axis=1), 2 * n + 1).mean(axis=1)
    return Effort(force, TABLE, power, np.ascontiguousarray(smooth))


@njit(cache=True)
def speed_effort(effort: Effort, v: float) -> tuple[float, float]:
    """The part of an effort that depends on the speed [N/kg], and its slope [N/kg per m/s]."""
    if effort.kind == HYPERBOLA:
        value = effort.power / max(v, 1e-3)
        return value, -value / max(v, 1e-3)
    if effort.kind == TABLE:
        place = v / TABLE_STEP_MPS
        last = effort.table.shape[0] - 2
        k = min(max(int(place), 0), last)
        part = place - k
        here = effort.table[k + 1] - effort.table[k]
        return effort.table[k] + part * here, here / TABLE_STEP_MPS
    return np.inf, 0.0


@njit(cache=True)
def stage_force(stages: Stages, k: int, y0: float, y1: float) -> float:
    """Mean force per mass of stage k [N/kg]."""
    mean = 0.5 * (np.sqrt(2.0 * y0) + np.sqrt(2.0 * y1))
    return (y1 - y0) / stages.dx[k] + stages.c0[k] + stages.c1 * mean + stages.c2 * (y0 + y1)  # type: ignore[no-any-return]
