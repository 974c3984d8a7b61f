"""PID with feed-forward: derivative filter on the error, clamping anti-windup.

`e = r - v;  d = N (kd e - Df);  u = kp e + I + d + ff;  I' = ki e;  Df' = d` (Fuzzy-D paper, PID controller,
with the derivative filter that reproduces its figures).
"""

from __future__ import annotations

from dataclasses import dataclass

from controller.laws import PAPER_CONTROL_MPS2, Measurement, Reference, carried_over, clamp, speed_error


@dataclass(frozen=True)
class PidGains:
    """Gains in acceleration units. The default is robust on a train of 0.1 s dead time and 0.4 s lag.

    With these the loop keeps a phase margin of about 50 degrees and a gain margin of about 11 dB.
    """

    kp_per_s: float = 2.0
    ki_per_s2: float = 0.3
    kd: float = 0.5
    derivative_filter_per_s: float = 3.3
    """N: the derivative acts up to this angular frequency."""
    feed_forward: bool = True
    """Add the plan's acceleration, and have the resistance added behind the law."""
    derivative_kick: bool = False
    """The derivative's filter starts at zero, as printed, so that a first error is differentiated too."""


PAPER = PidGains(
    kp_per_s=2.774,
    ki_per_s2=0.214,
    kd=4.088,
    derivative_filter_per_s=0.524,
    feed_forward=False,
    derivative_kick=True,
)
"""Gains of the Fuzzy-D paper in its own units of control per m/s; use with unlimited authority.

The paper prints no derivative filter. 0.524 1/s is the value at which its figures reproduce: overshoot 9.7 %,
15 m/s after 30 m (worked out by a scan over filters, saturation and structure).
"""

PAPER_ON_TRAIN = PidGains(
    kp_per_s=2.774 * PAPER_CONTROL_MPS2,
    ki_per_s2=0.214 * PAPER_CONTROL_MPS2,
    kd=4.088 * PAPER_CONTROL_MPS2,
    derivative_filter_per_s=0.524,
    feed_forward=False,
)
"""The paper's gains in acceleration units: 0.579 1/s, 0.0447 1/s2, 0.854."""


class Pid:
    """See the module docstring. Integrates only while unsaturated or driven out of saturation."""

    probe_names = (
        ("feedback_mps2", "m/s^2"),
        ("integral_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
    )

    def __init__(self, gains: PidGains) -> None:
        self._gains = gains
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the derivative filter."""
        self._integral = 0.0
        self._filter = 0.0
        self._started = self._gains.derivative_kick
        self._feedback = 0.0
        self._feed_forward = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        gains = self._gains
        error = speed_error(reference, measurement)
        if not self._started:
            self._filter = gains.kd * error
            self._started = True
        derivative = gains.derivative_filter_per_s * (gains.kd * error - self._filter)
        self._feedback = gains.kp_per_s * error + derivative
        before = self._feed_forward
        self._feed_forward = reference.preview_mps2 if gains.feed_forward else -measurement.resistance_mps2
        if gains.feed_forward:
            self._integral = carried_over(self._integral, before, self._feed_forward)
        free = self._feedback + self._integral + self._feed_forward
        demand = clamp(free, measurement.lowest_mps2, measurement.highest_mps2)
        if demand == free or (free > demand and error < 0.0) or (free < demand and error > 0.0):
            self._integral += gains.ki_per_s2 * error * dt_s
        self._filter += derivative * dt_s
        return demand

    def internals(self) -> tuple[float, ...]:
        """Feedback, integral and feed-forward shares [m/s2] of the last step."""
        return self._feedback, self._integral, self._feed_forward
