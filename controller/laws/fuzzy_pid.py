"""PID whose three gains a fuzzy system moves with the error and its rate (fuzzy-PID paper, section 2).

    K = max(0, K0 + r T / 3)      for kp, ki and kd, with T in -3 .. 3 from a 7x7 rule base each
    u = kp e + I + kd de + ff;    I' = ki e

The integral takes what `ki e` adds, so a change of a gain never makes the demand jump. Which tables: the
textbook's are not symmetric in the error; those built from the paper's words on |e| and |de| are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from controller.fuzzy.bases import fuzzy_pid_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import Measurement, Reference, carried_over, clamp, speed_error
from controller.laws.rate import ErrorRate

TERM_RANGE = 3.0


@dataclass(frozen=True)
class FuzzyPidParameters:
    """Gains for T = 0, how far T moves each, and the ranges over which the rules are spread."""

    kp_per_s: float = 1.7
    kp_range_per_s: float = 0.5
    """Change of kp at T = 3."""
    ki_per_s2: float = 0.2
    ki_range_per_s2: float = 0.1
    kd: float = 0.35
    kd_range: float = 0.15
    error_range_mps: float = 0.5
    rate_range_mps2: float = 1.0
    tables: Literal["textbook", "symmetric"] = "symmetric"
    rate_filter_s: float = 0.3
    """Smooths the error's rate: one odometer step of 0.01 km/h in 10 ms is 0.28 m/s2."""
    feed_forward: bool = True
    """Add the plan's acceleration, and have the resistance added behind the law."""


PAPER = FuzzyPidParameters(
    kp_per_s=0.6,
    kp_range_per_s=0.3,
    ki_per_s2=0.05,
    ki_range_per_s2=0.025,
    kd=0.1,
    kd_range=0.05,
    error_range_mps=1.5,
    rate_range_mps2=0.6,
    tables="textbook",
    feed_forward=False,
)
"""What the paper describes, with plausible numbers of ours: it prints neither gains, ranges nor tables.

Moderate gains as set by hand, moved by half; the error from a change of speed of its 36 km line, the rate
from the acceleration of its train; no feed-forward, of which it knows nothing.
"""


class FuzzyPid:
    """See the module docstring. Integrates only while unsaturated or driven out of saturation."""

    probe_names = (
        ("feedback_mps2", "m/s^2"),
        ("integral_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
        ("error_rate_mps2", "m/s^2"),
        ("kp_per_s", "1/s"),
        ("ki_per_s2", "1/s^2"),
        ("kd", "1"),
        ("rules_clipped", "1"),
    )

    def __init__(self, parameters: FuzzyPidParameters) -> None:
        self._parameters = p = parameters
        rules = fuzzy_pid_rules(p.error_range_mps, p.rate_range_mps2, tables=p.tables)
        self._kp_change = CompiledRuleBase(rules.kp)
        self._ki_change = CompiledRuleBase(rules.ki)
        self._kd_change = CompiledRuleBase(rules.kd)
        self._rate = ErrorRate(p.rate_filter_s)
        self.reset()

    def reset(self) -> None:
        """Forget the integral and the error's rate."""
        self._rate.reset()
        for rules in (self._kp_change, self._ki_change, self._kd_change):
            rules.reset()
        self._integral = 0.0
        self._feedback = 0.0
        self._feed_forward = 0.0
        self.gains = (self._parameters.kp_per_s, self._parameters.ki_per_s2, self._parameters.kd)

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input. `gains` are those it used."""
        p = self._parameters
        error = speed_error(reference, measurement)
        rate = self._rate.step(reference, measurement, dt_s)
        kp = max(0.0, p.kp_per_s + p.kp_range_per_s * self._kp_change(error, rate) / TERM_RANGE)
        ki = max(0.0, p.ki_per_s2 + p.ki_range_per_s2 * self._ki_change(error, rate) / TERM_RANGE)
        kd = max(0.0, p.kd + p.kd_range * self._kd_change(error, rate) / TERM_RANGE)
        self.gains = kp, ki, kd
        self._feedback = kp * error + kd * rate
        before = self._feed_forward
        self._feed_forward = reference.preview_mps2 if p.feed_forward else -measurement.resistance_mps2
        if p.feed_forward:
            self._integral = carried_over(self._integral, before, self._feed_forward)
        free = self._feedback + self._integral + self._feed_forward
        demand = clamp(free, measurement.lowest_mps2, measurement.highest_mps2)
        if demand == free or (free > demand and error < 0.0) or (free < demand and error > 0.0):
            self._integral += ki * error * dt_s
        return demand

    def internals(self) -> tuple[float, ...]:
        """Shares of the last demand and the error's rate [m/s2], the three gains, clipped or not."""
        shares = self._feedback, self._integral, self._feed_forward
        return *shares, self._rate.value_mps2, *self.gains, float(self._kp_change.is_clipping)
