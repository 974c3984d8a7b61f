"""From an acceleration to an effort demand: Newton, running resistance, gradient, and the train's efforts."""

from __future__ import annotations

from bisect import bisect_right

from hil.railway import Line, Train
from hil.railway.resistance import specific_to_n


class EffortMap:
    """The nominal train on its line, as a few look-ups a cycle can afford.

    The meaning of an effort demand is :meth:`hil.railway.Train.demand`, which the plant shares.
    """

    mass_kg: float
    """Nominal mass with rotating parts."""

    def __init__(self, line: Line, train: Train, *, resistance: bool = True) -> None:
        track = line.track_resistance
        self._train = train
        self._edges = track.edges_m.tolist()
        self._integral = track.integral_m.tolist()
        self._specific = track.specific_n_per_kn.tolist()
        self.mass_kg = train.effective_mass_kg
        self._length_m = train.length_m
        self._track_n_per_specific = specific_to_n(1.0, train.mass_kg)
        self._compensates = resistance

    def resistance_mps2(self, position_m: float, speed_mps: float) -> float:
        """Davis, gradient, curve and tunnel resistance over the effective mass; positive slows the train."""
        if not self._compensates:
            return 0.0
        length = self._length_m
        mean = (self._track_integral(position_m) - self._track_integral(position_m - length)) / length
        force = self._train.running_resistance_n(speed_mps) + mean * self._track_n_per_specific
        return force / self.mass_kg

    def authority_mps2(self, speed_mps: float, resistance_mps2: float) -> tuple[float, float]:
        """Lowest and highest acceleration that the nominal train reaches at this speed."""
        brake = self._train.service_brake_effort_n(speed_mps) / self.mass_kg
        traction = self._train.traction_effort_n(speed_mps) / self.mass_kg
        return -brake - resistance_mps2, traction - resistance_mps2

    def demand(self, acceleration_mps2: float, resistance_mps2: float, speed_mps: float) -> float:
        """Effort demand in [-1, 1] that gives this acceleration."""
        force = (acceleration_mps2 + resistance_mps2) * self.mass_kg
        return self._train.demand(force, speed_mps)

    def _track_integral(self, position_m: float) -> float:
        edges = self._edges
        k = bisect_right(edges, position_m) - 1
        if k < 0:
            return 0.0
        if k >= len(self._specific):
            return float(self._integral[-1])
        return float(self._integral[k] + (position_m - edges[k]) * self._specific[k])
