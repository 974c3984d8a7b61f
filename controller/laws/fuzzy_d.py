"""Fuzzy-D: a fuzzy controller of speed error and its rate, plus a derivative term (Fuzzy-D paper, eq. 6).

The paper's form is `u = K FLC(e, de) + KD de`. On a real train that alone leaves a static error and its gain
is bang-bang, so the law for a train adds an integral (clamping anti-windup) and the plan's acceleration as
feed-forward, with membership functions in m/s and m/s2. `PAPER` is the paper's form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from controller.fuzzy.bases import fuzzy_d_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import PAPER_CONTROL_MPS2, Measurement, Reference, carried_over, clamp, speed_error
from controller.laws.rate import ErrorRate


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
    feed_forward: bool = True
    """Add the plan's acceleration, and have the resistance added behind the law."""


PAPER_ERROR_PEAKS_MPS = (6.8655, 13.731)
PAPER_RATE_PEAKS_MPS2 = (1.443, 20.507)
PAPER_OUTPUT_PEAKS = (391.20, 399.57, 541.99)
"""Membership functions with which the Fuzzy-D paper's headline numbers reproduce, in its units of control.

The paper prints none. Found by differential evolution, one set for SpeedT and Fuzzy-D together: a solution,
not the authors' numbers. Rounding them moves the distance at which Fuzzy-D reaches its speed manyfold.
"""

PAPER = FuzzyDParameters(
    error_peaks_mps=PAPER_ERROR_PEAKS_MPS,
    rate_peaks_mps2=PAPER_RATE_PEAKS_MPS2,
    output_peaks_mps2=PAPER_OUTPUT_PEAKS,
    gain=10.0,
    derivative_gain=0.05,
    integral_gain_per_s2=0.0,
    rate_filter_s=0.0,
    feed_forward=False,
)
"""`u = 10 FLC(e, de) + 0.05 de` in the paper's units of control; the outputs are units, not m/s2.

Use with unlimited authority, the true acceleration in the measurement, and steps of at most 1 ms.
"""

PAPER_ON_TRAIN = replace(
    PAPER,
    output_peaks_mps2=(
        PAPER_OUTPUT_PEAKS[0] * PAPER_CONTROL_MPS2,
        PAPER_OUTPUT_PEAKS[1] * PAPER_CONTROL_MPS2,
        PAPER_OUTPUT_PEAKS[2] * PAPER_CONTROL_MPS2,
    ),
    derivative_gain=0.05 * PAPER_CONTROL_MPS2,
    rate_filter_s=0.3,
)
"""The paper's gains in acceleration units; the error's rate filtered, because the bus quantises the speed."""


class FuzzyD:
    """See the module docstring. Integrates only while unsaturated or driven out of saturation."""

    probe_names = (
        ("feedback_mps2", "m/s^2"),
        ("integral_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
        ("error_rate_mps2", "m/s^2"),
        ("rules_clipped", "1"),
        ("fuzzy_output_mps2", "m/s^2"),
    )

    def __init__(self, parameters: FuzzyDParameters) -> None:
        self._parameters = parameters
        self._fuzzy = CompiledRuleBase(
            fuzzy_d_rules(
                parameters.error_peaks_mps, parameters.rate_peaks_mps2, parameters.output_peaks_mps2
            )
        )
        self._rate = ErrorRate(parameters.rate_filter_s)
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the error's rate."""
        self._rate.reset()
        self._fuzzy.reset()
        self._integral = 0.0
        self._feedback = 0.0
        self._feed_forward = 0.0
        self._output = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        p = self._parameters
        error = speed_error(reference, measurement)
        rate = self._rate.step(reference, measurement, dt_s)
        self._output = self._fuzzy(error, rate)
        self._feedback = p.gain * self._output + p.derivative_gain * rate
        before = self._feed_forward
        self._feed_forward = reference.preview_mps2 if p.feed_forward else -measurement.resistance_mps2
        if p.feed_forward:
            self._integral = carried_over(self._integral, before, self._feed_forward)
        free = self._feedback + self._integral + self._feed_forward
        demand = clamp(free, measurement.lowest_mps2, measurement.highest_mps2)
        if demand == free or (free > demand and error < 0.0) or (free < demand and error > 0.0):
            self._integral += p.integral_gain_per_s2 * error * dt_s
        return demand

    def internals(self) -> tuple[float, ...]:
        """Shares of the last demand, the error's rate, clipped or not, output of the rules [m/s2]."""
        clipped = float(self._fuzzy.is_clipping)
        shares = self._feedback, self._integral, self._feed_forward
        return *shares, self._rate.value_mps2, clipped, self._output
