"""How much a force command chatters, beside the ideal command: the bench's own measures, on even samples."""

from __future__ import annotations

from typing import NamedTuple

from hil.bench.chatter import reversals, ripple, total_variation
from studies.figure import Floats

__all__ = ["Chatter", "chatter", "reversals_per_s"]


class Chatter(NamedTuple):
    """TVx, HF5 and REV of a command."""

    excess_variation_n_per_s: float
    """TVx: total variation per second beyond that of the ideal command."""
    high_frequency_n: float
    """HF5: RMS above 5 Hz (zero-phase Butterworth high-pass, 4th order)."""
    reversals_per_s: float
    """REV: turning points per second with more than 2 kN of travel."""


def chatter(command_n: Floats, ideal_n: Floats, step_s: float) -> Chatter:
    """The numbers of a command (n) [N] sampled every `step_s`, beside the ideal one (n) without chatter.

    ValueError if the samples are too few or too slow for a high-pass of 5 Hz.
    """
    duration_s = (len(command_n) - 1) * step_s
    high = ripple(command_n, step_s)
    if high is None:
        raise ValueError(f"{len(command_n)} samples every {step_s:g} s: too few for a high-pass of 5 Hz")
    return Chatter(
        (total_variation(command_n) - total_variation(ideal_n)) / duration_s,
        high,
        reversals_per_s(command_n, step_s),
    )


def reversals_per_s(command_n: Floats, step_s: float) -> float:
    """Turning points per second of a command (n), counted with a hysteresis of 2 kN."""
    return reversals(command_n) / ((len(command_n) - 1) * step_s)
