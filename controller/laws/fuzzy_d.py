"""Fuzzy-D: a fuzzy controller of speed error and its rate, plus a derivative term (Fuzzy-D paper, eq. 6).

The paper's form is `u = K FLC(e, de) + KD de`. On a real train that alone leaves a static error and its gain
is bang-bang, so the law for a train adds an integral (clamping anti-windup) and the plan's acceleration as
feed-forward, with membership functions in m/s and m/s2. `integral = 0` and no feed-forward give the paper's
form back.
"""

from __future__ import annotations

from dataclasses import dataclass

from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.rulebase import fuzzy_d_rules
from controller.laws import Measurement, Reference, carried_over, clamp


@dataclass(frozen=True)
class FuzzyDParameters:
    """Positive peaks of the symmetric membership functions (S, B and S, M, B) and the gains."""

    error_peaks_mps: tuple[float, float] = (0.5, 1.0)
    rate_peaks_mps2: tuple[float, float] = (1.0, 2.0)
    output_peaks_mps2: tuple[float, float, float] = (0.5, 1.0, 1.5)
    gain: float = 1.0
    derivative_gain: float = 0.2
    integral_gain_per_s2: float = 0.25
    rate_filter_s: float = 0.3
    """Smooths the error's rate: one odometer step of 0.01 km/h in 10 ms is 0.28 m/s2."""


class FuzzyD:
    """See the module docstring. Integrates only while unsaturated or driven out of saturation."""

    probe_names = (
        ("feedback_mps2", "m/s^2"),
        ("integral_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
        ("error_rate_mps2", "m/s^2"),
        ("fuzzy_output_mps2", "m/s^2"),
    )

    def __init__(self, parameters: FuzzyDParameters) -> None:
        self._parameters = parameters
        self._fuzzy = CompiledRuleBase(
            fuzzy_d_rules(
                parameters.error_peaks_mps, parameters.rate_peaks_mps2, parameters.output_peaks_mps2
            )
        )
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the error's rate."""
        self._integral = 0.0
        self._speed_mps: float | None = None
        self._feedback = 0.0
        self._feed_forward = 0.0
        self._error_rate = 0.0
        self._output = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        p = self._parameters
        speed = measurement.speed_mps
        if self._speed_mps is None:
            self._speed_mps = speed
        measured = (speed - self._speed_mps) / dt_s
        self._speed_mps = speed
        # Planned and measured acceleration pass the same filter: with only one of them delayed, a change of
        # the plan would look like an error and turn into one (4 cm at the stop).
        rate = reference.acceleration_mps2 - measured
        self._error_rate += dt_s / (p.rate_filter_s + dt_s) * (rate - self._error_rate)
        error = reference.speed_mps - speed
        self._output = self._fuzzy(error, self._error_rate)
        self._feedback = p.gain * self._output + p.derivative_gain * self._error_rate
        before, self._feed_forward = self._feed_forward, reference.preview_mps2
        self._integral = carried_over(self._integral, before, self._feed_forward)

        free = self._feedback + self._integral + self._feed_forward
        demand = clamp(free, measurement.lowest_mps2, measurement.highest_mps2)
        if demand == free or (free > demand and error < 0.0) or (free < demand and error > 0.0):
            self._integral += p.integral_gain_per_s2 * error * dt_s
        return demand

    def internals(self) -> tuple[float, ...]:
        """Shares of the last demand, the error's rate and the fuzzy controller's output [m/s2]."""
        return self._feedback, self._integral, self._feed_forward, self._error_rate, self._output
