"""The train as both sides may know it: mass, running resistance, drives, brakes, and what an effort
demand means.

Efforts are at the wheel rim. Everything here is static; how fast a drive answers is given as numbers
(lag, dead time, jerk limit) that the plant simulates and the controller may plan with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from hil.railway.errors import RailwayDataError
from hil.railway.resistance import curtius_kniffler, davis_n, specific_to_n


@dataclass(frozen=True)
class EffortCurve:
    """Largest effort over speed: a constant, a power hyperbola and a table, the lowest of those given.

    `points` are `(speed_mps, effort_n)` with ascending speeds, constant beyond the ends.
    """

    max_effort_n: float
    max_power_w: float | None = None
    points: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for (low, _), (high, _) in pairwise(self.points):
            if not high > low:
                raise RailwayDataError(f"points: speed {high:g} m/s follows {low:g} m/s; speeds must ascend")

    def effort_n(self, speed_mps: float) -> float:
        """Effort available at this speed [N]; a negative speed counts as standstill."""
        effort = self.max_effort_n
        if self.max_power_w is not None and speed_mps * effort > self.max_power_w:
            effort = self.max_power_w / speed_mps
        if self.points:
            effort = min(effort, _interpolate(self.points, speed_mps))
        return effort


@dataclass(frozen=True)
class DavisCoefficients:
    """Running resistance a + b v + c v^2, v in m/s."""

    a_n: float
    b_n_per_mps: float
    c_n_per_mps2: float

    def resistance_n(self, speed_mps: float) -> float:
        """Running resistance [N], never negative: it acts against the motion."""
        return davis_n(speed_mps, self.a_n, self.b_n_per_mps, self.c_n_per_mps2)


@dataclass(frozen=True)
class TractionDrive:
    """Traction: effort curve, dead time, jerk limit, then a first-order lag."""

    curve: EffortCurve
    time_constant_s: float
    dead_time_s: float
    jerk_limit_mps3: float


@dataclass(frozen=True)
class ElectrodynamicBrake:
    """Motor brake: full above `fade_start_mps`, none below `fade_end_mps`, linear between."""

    curve: EffortCurve
    time_constant_s: float
    dead_time_s: float
    jerk_limit_mps3: float
    fade_start_mps: float
    fade_end_mps: float

    def __post_init__(self) -> None:
        if not self.fade_start_mps > self.fade_end_mps:
            raise RailwayDataError(
                f"electrodynamic: fade start {self.fade_start_mps:g} m/s "
                f"must be greater than fade end {self.fade_end_mps:g} m/s"
            )

    def fade(self, speed_mps: float) -> float:
        """Share of the effort that is left at this speed, 0 to 1."""
        span = self.fade_start_mps - self.fade_end_mps
        return min(1.0, max(0.0, (speed_mps - self.fade_end_mps) / span))

    def effort_n(self, speed_mps: float) -> float:
        """Brake effort available at this speed [N], positive."""
        return self.curve.effort_n(speed_mps) * self.fade(speed_mps)


@dataclass(frozen=True)
class PneumaticBrake:
    """Friction brake: service, emergency and holding effort, all positive; dead time, then a lag."""

    max_effort_n: float
    time_constant_s: float
    dead_time_s: float
    emergency_effort_n: float
    holding_effort_n: float


@dataclass(frozen=True, kw_only=True)
class Train:
    """A train with its nominal values.

    An effort demand is in [-1, 1]. From 0 up it is a fraction of the traction curve at the present
    speed, below 0 a fraction of `service_brake_effort_n`, whoever brakes. `effort_n` and `demand`
    are the one definition that controller and plant share. A plant whose true mass differs keeps
    the nominal train for these two, as a real traction unit would.
    """

    name: str
    title: str = ""
    source: str = ""
    mass_kg: float
    rotating_mass_factor: float = 0.0  # added inertia of rotating parts as a fraction of the mass
    length_m: float
    davis: DavisCoefficients
    starting_resistance_n_per_kn: float = 0.0  # in addition to Davis, while the train stands
    powered_mass_fraction: float = 1.0  # share of the weight on motored axles
    traction: TractionDrive
    electrodynamic: ElectrodynamicBrake
    pneumatic: PneumaticBrake
    max_acceleration_mps2: float
    max_braking_mps2: float  # full service brake, positive
    comfort_jerk_mps3: float
    max_speed_mps: float = math.inf  # of the vehicle, whatever the line permits
    traction_efficiency: float = 1.0  # work at the wheel rim over energy from the line
    regeneration_efficiency: float = 0.0  # energy back to the line over electrodynamic braking work

    def __post_init__(self) -> None:
        if not 0.0 < self.traction_efficiency <= 1.0:
            raise RailwayDataError(
                f"traction_efficiency: {self.traction_efficiency:g} must be greater than 0 and at most 1"
            )
        if not 0.0 <= self.regeneration_efficiency <= 1.0:
            raise RailwayDataError(
                f"regeneration_efficiency: {self.regeneration_efficiency:g} must be at least 0 and at most 1"
            )
        if not self.max_speed_mps > 0.0:
            raise RailwayDataError(f"max_speed_mps: {self.max_speed_mps:g} must be greater than 0")

    @property
    def effective_mass_kg(self) -> float:
        """Mass with the allowance for rotating parts [kg]."""
        return self.mass_kg * (1.0 + self.rotating_mass_factor)

    def line_energy_j(self, traction_j: float, regenerated_j: float) -> float:
        """Net energy [J] at the line side of this much traction and electrodynamic braking work.

        Losses between pantograph and wheel rim as two constant efficiencies, as TTOBench has them
        (Kouzoupis et al. 2023, doi:10.1007/s43069-023-00248-x); no auxiliaries.
        """
        return traction_j / self.traction_efficiency - self.regeneration_efficiency * regenerated_j

    def traction_effort_n(self, speed_mps: float) -> float:
        """Effort of demand +1 at this speed [N]."""
        return self.traction.curve.effort_n(speed_mps)

    def service_brake_effort_n(self, speed_mps: float = 0.0) -> float:
        """Effort of demand -1 [N], positive: what gives `max_braking_mps2` on level track.

        Independent of the speed and of how the brakes share it; the argument keeps the form of
        `traction_effort_n`.
        """
        return self.effective_mass_kg * self.max_braking_mps2

    def effort_n(self, demand: float, speed_mps: float) -> float:
        """Effort [N] that a demand in [-1, 1] asks for at this speed; demands beyond are limited."""
        if demand >= 0.0:
            return min(demand, 1.0) * self.traction_effort_n(speed_mps)
        return max(demand, -1.0) * self.service_brake_effort_n(speed_mps)

    def demand(self, effort_n: float, speed_mps: float) -> float:
        """Demand in [-1, 1] that asks for this effort [N] at this speed, limited to what there is."""
        if effort_n >= 0.0:
            available = self.traction_effort_n(speed_mps)
            return min(1.0, effort_n / available) if available > 0.0 else 0.0
        return max(-1.0, effort_n / self.service_brake_effort_n(speed_mps))

    def running_resistance_n(self, speed_mps: float) -> float:
        """Davis resistance [N]."""
        return self.davis.resistance_n(speed_mps)

    def track_resistance_n(self, specific_n_per_kn: float) -> float:
        """Force [N] of a specific track resistance [N/kN] on this train, positive against the travel."""
        return specific_to_n(specific_n_per_kn, self.mass_kg)

    def adhesion_limit_n(self, speed_mps: float) -> float:
        """Largest effort that the motored axles carry on dry rail [N] (Curtius/Kniffler)."""
        return specific_to_n(1000.0 * curtius_kniffler(speed_mps), self.mass_kg * self.powered_mass_fraction)


def _interpolate(points: tuple[tuple[float, float], ...], speed_mps: float) -> float:
    """Linear interpolation w1 + (v - v1)(w2 - w1)/(v2 - v1), constant beyond the ends.

    This is equation 1 of Nguyen (2020); as printed its numerator has v2 - v1 in place of w2 - w1.
    """
    if speed_mps <= points[0][0]:
        return points[0][1]
    for (v1, w1), (v2, w2) in pairwise(points):
        if speed_mps <= v2:
            return w1 + (speed_mps - v1) * (w2 - w1) / (v2 - v1)
    return points[-1][1]
