"""How fast the speed error changes, without differencing a quantised speed more than a filter can bear."""

from __future__ import annotations

from controller.laws import Measurement, Reference


class ErrorRate:
    """Planned minus measured acceleration [m/s2] through one first-order filter of `filter_s` (0: none).

    Where the measurement carries the true acceleration, as a study's plant does, that is used; otherwise
    the speed is differenced: one odometer step of 0.01 km/h in 10 ms is 0.28 m/s2, which the filter smooths.

    Planned and measured acceleration pass the same filter: with only one of them delayed, a change of the
    plan would look like an error and turn into one (4 cm at the stop).
    """

    def __init__(self, filter_s: float) -> None:
        self._filter_s = filter_s
        self.reset()

    def reset(self) -> None:
        """Forget the last speed; the rate is 0 until there are two."""
        self.value_mps2 = 0.0
        self._speed_mps: float | None = None

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """The error's rate [m/s2] with this cycle's values."""
        speed = measurement.speed_mps
        before = speed if self._speed_mps is None else self._speed_mps
        self._speed_mps = speed
        known = measurement.acceleration_mps2
        measured = (speed - before) / dt_s if known is None else known
        rate = reference.acceleration_mps2 - measured
        self.value_mps2 += dt_s / (self._filter_s + dt_s) * (rate - self.value_mps2)
        return self.value_mps2
