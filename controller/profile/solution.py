"""A solved speed profile: speeds, forces, times, and where the energy went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controller.profile.problem import Problem
from controller.profile.profile import Floats, SpeedProfile
from hil.railway import GRAVITY_MPS2


@dataclass(frozen=True)
class Solution:
    """A profile that keeps every limit of its problem.

    Shapes: `speed_mps` and `time_s` (N+1) at the nodes; `acceleration_mps2` and `force_n` (N) per stage, the
    latter at the rim, traction positive. `traction_j`, `braked_j` (all brakes) and `regenerated_j` (the
    regenerative brake within its limits; 0 without regeneration) are work at the rim; `net_j` is energy at
    the line, `traction_j / traction_efficiency - regeneration_efficiency * regenerated_j`, or what the
    efficiency map makes of it. `multiplier_w` is -dE/dT, what one second more would save.
    """

    problem: Problem
    solver: str
    speed_mps: Floats
    time_s: Floats
    acceleration_mps2: Floats
    force_n: Floats
    trip_time_s: float
    min_time_s: float
    solve_time_s: float
    iterations: int
    traction_j: float
    regenerated_j: float
    braked_j: float
    net_j: float
    multiplier_w: float

    @classmethod
    def of_speeds(
        cls,
        problem: Problem,
        speed_mps: Floats,
        *,
        solver: str,
        min_time_s: float,
        solve_time_s: float = 0.0,
        iterations: int = 0,
        multiplier_w: float = 0.0,
    ) -> Solution:
        """Solution with these speeds at the nodes; all else follows from them (see `stage_forces_n`)."""
        step = np.diff(problem.position_m)
        mean = 0.5 * (speed_mps[1:] + speed_mps[:-1])
        time = np.concatenate(([0.0], np.cumsum(step / mean)))
        force = stage_forces_n(problem, speed_mps)
        regenerative = np.zeros(len(step))
        drive = problem.drive
        mapped = None if drive is None else drive.efficiency
        if problem.regeneration_efficiency > 0.0 or mapped is not None:
            available = problem.braking.force_n(np.maximum(speed_mps[1:], speed_mps[:-1]))
            if problem.braking.points:  # a table may be lower at the slower end
                available = np.minimum(
                    available, problem.braking.force_n(np.minimum(speed_mps[1:], speed_mps[:-1]))
                )
            regenerative = np.minimum(np.maximum(-force, 0.0), available)
        if drive is not None:
            regenerative[drive.neutral_stages(problem.position_m)] = 0.0
        traction = float(np.sum(step * np.maximum(force, 0.0)))
        regenerated = float(np.sum(step * regenerative))
        net = traction / problem.traction_efficiency - problem.regeneration_efficiency * regenerated
        if mapped is not None:
            net = float(np.sum(step * mapped.line_force_n(mean, np.maximum(force, 0.0), regenerative)))
        return cls(
            problem=problem,
            solver=solver,
            speed_mps=speed_mps,
            time_s=time,
            acceleration_mps2=np.diff(speed_mps) * mean / step,
            force_n=force,
            trip_time_s=float(time[-1]),
            min_time_s=min_time_s,
            solve_time_s=solve_time_s,
            iterations=iterations,
            traction_j=traction,
            regenerated_j=regenerated,
            braked_j=float(np.sum(step * np.maximum(-force, 0.0))),
            net_j=net,
            multiplier_w=multiplier_w,
        )

    def profile(self, start_m: float = 0.0) -> SpeedProfile:
        """The profile for the reference, its positions beginning at `start_m`."""
        return SpeedProfile.from_speeds(self.problem.position_m + start_m, self.speed_mps)


def stage_forces_n(problem: Problem, speed_mps: Floats) -> Floats:
    """Mean force at the rim [N] of each stage (N): inertia, Davis and track resistance.

    Davis is a + b times the mean of the two speeds + c times the mean of their squares; the last is exact,
    since v^2 is linear in position within a stage.
    """
    step = np.diff(problem.position_m)
    y = 0.5 * speed_mps**2
    davis = problem.davis
    resistance = (
        davis.a_n
        + davis.b_n_per_mps * 0.5 * (speed_mps[1:] + speed_mps[:-1])
        + davis.c_n_per_mps2 * (y[1:] + y[:-1])
        + problem.track_n_per_kn * problem.mass_kg * GRAVITY_MPS2 * 1e-3
    )
    force: Floats = problem.effective_mass_kg * np.diff(y) / step + resistance
    return force
