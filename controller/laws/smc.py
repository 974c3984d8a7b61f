"""Sliding mode of the speed error with the gain that its reaching condition asks for (FSMC paper, eqs 11-21).

    s = v - vd
    k(t) = beta (F + eta + D) + (beta - 1) |dvd/dt + w / M|
    u / M = dvd/dt - k(t) sgn(s)          and the resistance w / M, added behind the law

(The printed equation 21 has lost its minus sign.) Over a bus with a drive behind it, sgn(s) chatters with
tens of kN. The law for a train puts a boundary layer in its place: `sat(s / phi)`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, sqrt

from controller.laws import Measurement, Reference, clamp, speed_error

PAPER_MASS_RATIO = 305.0 / 252.5
"""Largest over nominal mass; the law's own mass is their geometric mean, 277 511 kg (eq. 16)."""


@dataclass(frozen=True)
class SmcParameters:
    """Bounds of what the law must overcome, in accelerations."""

    beta: float = sqrt(PAPER_MASS_RATIO)
    """Gain margin (eq. 20): the root of largest over smallest mass."""
    uncertainty_mps2: float = 0.0
    """F: bound of the error of the modelled resistance."""
    reaching_mps2: float = 0.1
    """eta: how fast s falls at least."""
    disturbance_mps2: float = 0.1
    """D: bound of the disturbance."""
    boundary_layer_mps: float = 0.12
    """phi: within it, the sign is replaced by a straight line; 0 for the sign itself."""
    preview: bool = True
    """Take the plan's acceleration ahead of the drive's delay; False as printed: the acceleration now."""


PAPER = SmcParameters(disturbance_mps2=0.0, boundary_layer_mps=0.0, preview=False)
"""The paper's nominal case; D = 0.1 m/s2 in its disturbed one.

The demand times 277 511 kg, plus w, is its force.
"""


class Smc:
    """See the module docstring. Without state."""

    probe_names = (
        ("sliding_surface_mps", "m/s"),
        ("sliding_gain_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
    )

    def __init__(self, parameters: SmcParameters) -> None:
        self._parameters = parameters
        self.reset()

    def reset(self) -> None:
        """Nothing to forget but what is shown."""
        self._s = 0.0
        self._gain = 0.0
        self._feed_forward = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        p = self._parameters
        self._s = s = -speed_error(reference, measurement)
        wanted = reference.preview_mps2 if p.preview else reference.acceleration_mps2
        bounds = p.uncertainty_mps2 + p.reaching_mps2 + p.disturbance_mps2
        self._gain = p.beta * bounds + (p.beta - 1.0) * abs(wanted + measurement.resistance_mps2)
        self._feed_forward = wanted
        if p.boundary_layer_mps > 0.0:
            switched = clamp(s / p.boundary_layer_mps, -1.0, 1.0)
        else:
            switched = copysign(1.0, s) if s != 0.0 else 0.0
        return clamp(wanted - self._gain * switched, measurement.lowest_mps2, measurement.highest_mps2)

    def internals(self) -> tuple[float, ...]:
        """Surface s [m/s], k and the planned acceleration [m/s2] of the last step."""
        return self._s, self._gain, self._feed_forward
