"""SpeedT: the fuzzy controller alone, `u = FLC(e, de)` (Fuzzy-D paper, Table 1).

No integral and no derivative term: whatever resistance or mass nobody told it of stays as a speed error.
On a train the plan's acceleration is added as feed-forward. The rule base is that of Fuzzy-D.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from controller.fuzzy.bases import fuzzy_d_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.laws import PAPER_CONTROL_MPS2, Measurement, Reference, clamp, speed_error
from controller.laws.fuzzy_d import PAPER_ERROR_PEAKS_MPS, PAPER_OUTPUT_PEAKS, PAPER_RATE_PEAKS_MPS2
from controller.laws.rate import ErrorRate


@dataclass(frozen=True)
class SpeedTParameters:
    """Positive peaks of the symmetric membership functions: S, B and S, B and S, M, B."""

    error_peaks_mps: tuple[float, float] = (0.5, 1.0)
    rate_peaks_mps2: tuple[float, float] = (1.0, 2.0)
    output_peaks_mps2: tuple[float, float, float] = (0.5, 1.0, 1.5)
    rate_filter_s: float = 0.3
    """Smooths the error's rate: one odometer step of 0.01 km/h in 10 ms is 0.28 m/s2."""
    feed_forward: bool = True
    """Add the plan's acceleration, and have the resistance added behind the law."""


PAPER = SpeedTParameters(
    error_peaks_mps=PAPER_ERROR_PEAKS_MPS,
    rate_peaks_mps2=PAPER_RATE_PEAKS_MPS2,
    output_peaks_mps2=PAPER_OUTPUT_PEAKS,
    rate_filter_s=0.0,
    feed_forward=False,
)
"""The paper's form in its own units of control; see `controller.laws.fuzzy_d.PAPER` for how to use it."""

PAPER_ON_TRAIN = replace(
    PAPER,
    output_peaks_mps2=(
        PAPER_OUTPUT_PEAKS[0] * PAPER_CONTROL_MPS2,
        PAPER_OUTPUT_PEAKS[1] * PAPER_CONTROL_MPS2,
        PAPER_OUTPUT_PEAKS[2] * PAPER_CONTROL_MPS2,
    ),
    rate_filter_s=0.3,
)
"""The paper's form in acceleration units; the error's rate filtered, because the bus quantises the speed."""


class SpeedT:
    """See the module docstring. Without state but for the error's rate."""

    probe_names = (
        ("fuzzy_output_mps2", "m/s^2"),
        ("feed_forward_mps2", "m/s^2"),
        ("error_rate_mps2", "m/s^2"),
        ("rules_clipped", "1"),
    )

    def __init__(self, parameters: SpeedTParameters) -> None:
        self._parameters = parameters
        self._fuzzy = CompiledRuleBase(
            fuzzy_d_rules(
                parameters.error_peaks_mps, parameters.rate_peaks_mps2, parameters.output_peaks_mps2
            )
        )
        self._rate = ErrorRate(parameters.rate_filter_s)
        self.reset()

    def reset(self) -> None:
        """Forget the error's rate."""
        self._rate.reset()
        self._fuzzy.reset()
        self._output = 0.0
        self._feed_forward = 0.0

    def step(self, reference: Reference, measurement: Measurement, dt_s: float) -> float:
        """Acceleration demand [m/s2]; ValueError on a non-finite input."""
        error = speed_error(reference, measurement)
        self._output = self._fuzzy(error, self._rate.step(reference, measurement, dt_s))
        forward = self._parameters.feed_forward
        self._feed_forward = reference.preview_mps2 if forward else -measurement.resistance_mps2
        return clamp(self._output + self._feed_forward, measurement.lowest_mps2, measurement.highest_mps2)

    def internals(self) -> tuple[float, ...]:
        """Fuzzy and feed-forward shares of the last demand, the error's rate [m/s2], clipped or not."""
        return self._output, self._feed_forward, self._rate.value_mps2, float(self._fuzzy.is_clipping)
