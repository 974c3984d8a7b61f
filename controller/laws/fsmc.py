"""Fuzzy sliding mode: 25 rules of s and its rate in place of the sign (FSMC paper, eqs 30-43 and Table 1).

    s = v - vd
    u / M = dvd/dt - K uf(s, ds/dt)       and the resistance w / M, added behind the law

The sign before K is that of equations 30 and 42; with the plus of the printed 31 and 34 the loop diverges.
The paper differences s from sample to sample. One step of a speed quantised to 0.01 km/h is then 0.28 m/s2
and, with its gains, 47 kN: the law for a train filters the rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from controller.fuzzy.bases import fsmc_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import Measurement, Reference, clamp, speed_error
from controller.laws.rate import ErrorRate

KMH_PER_MPS = 3.6


@dataclass(frozen=True)
class FsmcParameters:
    """Gain, half ranges of the two inputs, and how the rate is had."""

    gain_mps2: float = 1.6
    """K; the output of the rules is -1 .. 1."""
    half_range_s: float = 0.4
    """Of s, in `s_input_unit`; beyond it the rules clip."""
    half_range_rate_mps2: float = 4.0
    s_input_unit: Literal["m/s", "km/h"] = "m/s"
    """In which unit s enters the rules. The paper is silent; its disturbed error fits km/h, its force m/s."""
    rate_filter_s: float = 0.3
    """Of the rate of s; 0 as printed: the backward difference of s, 0 at first."""
    preview: bool = True
    """Take the plan's acceleration ahead of the drive's delay; False as printed: the acceleration now."""


PAPER = FsmcParameters(
    gain_mps2=1.0, half_range_s=0.75, half_range_rate_mps2=0.75, rate_filter_s=0.0, preview=False
)
"""As printed, everything in SI; demand times 252 500 kg, plus w, is its force. Sample time 0.01 s."""


class Fsmc:
    """See the module docstring."""

    probe_names = (
        ("sliding_surface_mps", "m/s"),
        ("surface_rate_mps2", "m/s^2"),
        ("fuzzy_output", "1"),
        ("feed_forward_mps2", "m/s^2"),
        ("rules_clipped", "1"),
    )

    def __init__(self, parameters: FsmcParameters) -> None:
        self._parameters = parameters
        self._fuzzy = CompiledRuleBase(fsmc_rules(parameters.half_range_s, parameters.half_range_rate_mps2))
        self._s_factor = KMH_PER_MPS if parameters.s_input_unit == "km/h" else 1.0
        self._rate = ErrorRate(parameters.rate_filter_s)
        self.reset()

    def reset(self) -> None:
        """Forget the last s and its rate."""
        self._rate.reset()
        self._fuzzy.reset()
        self._last_s: float | None = None
        self._s = 0.0
        self._s_rate = 0.0
        self._output = 0.0
        self._feed_forward = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        p = self._parameters
        self._s = s = -speed_error(reference, measurement)
        if p.rate_filter_s > 0.0:
            self._s_rate = -self._rate.step(reference, measurement, dt_s)
        else:
            self._s_rate = 0.0 if self._last_s is None else (s - self._last_s) / dt_s
            self._last_s = s
        self._output = self._fuzzy(self._s_factor * s, self._s_rate)
        self._feed_forward = reference.preview_mps2 if p.preview else reference.acceleration_mps2
        free = self._feed_forward - p.gain_mps2 * self._output
        return clamp(free, measurement.lowest_mps2, measurement.highest_mps2)

    def internals(self) -> tuple[float, ...]:
        """Surface s [m/s], its rate [m/s2], output of the rules [1], ff [m/s2], clipped or not."""
        return self._s, self._s_rate, self._output, self._feed_forward, float(self._fuzzy.is_clipping)
