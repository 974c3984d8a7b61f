"""The train as it really is: the nominal train, its deviations from it, and the line under it.

The controller and the plant's own control units know the nominal `Train` only. What acts on the mass
is the nominal effort times the factors given here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import sin
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.railway import Line, TrackResistance, Train
from hil.railway.resistance import curtius_kniffler, specific_to_n

FloatArray = npt.NDArray[np.float64]

RATE_LOOP_S = 0.02
"""Time constant of the loops that limit the rate of an effort; short against every drive here."""

PROMPT_RATE_FACTOR = 2.5
"""How much faster than in service an effort may change when traction is cut or a brake is prompt."""

BLOCKED_LAG_S = 0.1
"""Lag of a braking drive whose converter is blocked, if its own is longer: nothing regulates the decay."""

SLIDE_MARGIN_N = 1.0
"""A brake held back by less than this does not slide: the sums that are compared differ by rounding, and a
released brake decays to the smallest numbers there are, where a relative margin means nothing.
"""

PULSES_OFF_S = 0.008
"""Time constant with which tractive effort dies once the converter's pulses are off: the motor current's.

A cut must be over 100 ms after the last command: 50 ms of silence limit, a cycle, and five of these.
"""


@dataclass(frozen=True)
class Deviations:
    """How the true train differs from the nominal one; factors of the nominal value."""

    mass_factor: float = 1.0
    traction_factor: float = 1.0
    brake_factor: float = 1.0
    davis_factor: float = 1.0
    time_constant_factor: float = 1.0
    dead_time_factor: float = 1.0
    adhesion: float = 1.0
    """Factor of the adhesion of dry rail."""
    gradient_factor: float = 1.0
    friction_brake_factor: float = 1.0
    """Of the friction brake alone, on top of `brake_factor`."""
    friction_time_constant_factor: float = 1.0
    """Of the friction brake; `time_constant_factor` is that of the drive."""


@dataclass(frozen=True)
class Disturbance:
    """An acceleration A sin(w t + phase), t from the start of the run; FSMC paper, equation 11."""

    amplitude_mps2: float = 0.0
    angular_frequency_radps: float = 1.0
    phase_rad: float = 0.0

    def acceleration_mps2(self, time_s: float) -> float:
        """Positive pushes forward."""
        return self.amplitude_mps2 * sin(self.angular_frequency_radps * time_s + self.phase_rad)


@dataclass(frozen=True)
class Vehicle:
    """A true train on a line; with `point_mass` it has no length."""

    train: Train
    line: Line
    deviations: Deviations = field(default_factory=Deviations)
    point_mass: bool = False
    disturbance: Disturbance = field(default_factory=Disturbance)

    @property
    def length_m(self) -> float:
        """Length over which the track resistance is averaged."""
        return 0.0 if self.point_mass else self.train.length_m

    @property
    def mass_kg(self) -> float:
        """True mass, without rotating parts."""
        return self.train.mass_kg * self.deviations.mass_factor

    @property
    def effective_mass_kg(self) -> float:
        """True mass with the nominal rotating parts: load does not rotate."""
        return self.mass_kg + self.train.mass_kg * self.train.rotating_mass_factor

    def davis_n(self, speed_mps: float) -> float:
        """True running resistance [N]."""
        return self.deviations.davis_factor * self.train.running_resistance_n(speed_mps)

    def track(self, front_m: float, time_s: float = 0.0) -> TrackForces:
        """What the track, and the disturbance, do to the train here and now."""
        gradient = self.line.mean_gradient(front_m, self.length_m)
        total = self.line.mean_specific_resistance(front_m, self.length_m)
        pull_n = self.effective_mass_kg * self.disturbance.acceleration_mps2(time_s)
        return TrackForces(
            specific_to_n(gradient * self.deviations.gradient_factor, self.mass_kg) - pull_n,
            specific_to_n(total - gradient, self.mass_kg),
        )

    def adhesion_coefficient(self, speed_mps: float) -> float:
        """Largest ratio of effort to weight [1]."""
        return self.deviations.adhesion * curtius_kniffler(speed_mps)

    def gradient_and_friction(self) -> tuple[TrackResistance, TrackResistance]:
        """The line's gradient, and its curves and tunnels, as arrays over the same edges."""
        total = self.line.track_resistance
        edges = np.array(total.edges_m)
        middles = 0.5 * (edges[:-1] + edges[1:])
        gradient = np.array([self.line.gradient_permille(x) for x in middles])
        return (
            TrackResistance.from_steps(edges, gradient * self.deviations.gradient_factor),
            TrackResistance.from_steps(edges, total.specific_n_per_kn - gradient),
        )


class TrackForces(NamedTuple):
    """Forces of the track on the train [N]."""

    gradient_n: float
    """Pulls back uphill (positive) and forward downhill (negative), moving or not; so does a disturbance."""
    friction_n: float
    """Curves and tunnels: never negative, against the motion."""


class WheelForces(NamedTuple):
    """Efforts that reach the rail [N], none negative."""

    traction_n: float
    electrodynamic_n: float
    pneumatic_n: float
    slips: bool
    """Traction is more than the motored axles carry."""
    slides: bool
    """Braking is more than an axle carries."""


def at_the_rail(vehicle: Vehicle, speed_mps: float, drive_n: float, pneumatic_n: float) -> WheelForces:
    """Nominal efforts of drive (signed) and friction brake as they reach the rail.

    A motored axle carries the electrodynamic brake first and its share of the friction brake with
    what is left; slip and slide protection are ideal: they hold the effort at the adhesion limit.
    """
    deviations = vehicle.deviations
    weight_n = specific_to_n(1000.0, vehicle.mass_kg)
    limit_n = vehicle.adhesion_coefficient(speed_mps) * weight_n
    motored = vehicle.train.powered_mass_fraction
    traction_n = deviations.traction_factor * max(0.0, drive_n)
    electrodynamic_n = deviations.brake_factor * max(0.0, -drive_n)
    friction_n = deviations.brake_factor * deviations.friction_brake_factor * pneumatic_n
    limited_traction_n = min(traction_n, motored * limit_n)
    limited_electrodynamic_n = min(electrodynamic_n, motored * limit_n)
    on_motored_n = min(motored * friction_n, motored * limit_n - limited_electrodynamic_n)
    on_trailing_n = min((1.0 - motored) * friction_n, (1.0 - motored) * limit_n)
    limited_friction_n = on_motored_n + on_trailing_n
    braked_n = electrodynamic_n + friction_n
    return WheelForces(
        limited_traction_n,
        limited_electrodynamic_n,
        limited_friction_n,
        traction_n > limited_traction_n,
        braked_n > limited_electrodynamic_n + limited_friction_n + SLIDE_MARGIN_N,
    )
