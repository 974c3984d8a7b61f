"""How much a command chatters: TVx, HF5 and REV. Pure functions over arrays; SI units.

Three measures, because each alone can be cheated: total variation sees any movement beyond what the task
needs, the high-pass sees small fast ripple, the count of turning points sees slow limit cycles. The limits
of "no chatter" are 6 kN/s, 0.15 kN (0.04 % of a 403 kN drive) and 0.1 turning points per second beyond
those of the ideal command.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hil.bench.metrics import Array

START_S = 3.0
"""The first seconds do not count: a start from rest is a step for every law."""

HIGH_PASS_HZ = 5.0
HIGH_PASS_ORDER = 4
TURN_N = 2_000.0
"""A turning point counts once the command has come back by more than this."""


@dataclass(frozen=True)
class Chatter:
    """The three measures of one run; `None` where it was too short. `ideal_*` belong to the ideal command."""

    excess_variation_n_per_s: float | None
    ripple_n: float | None
    reversals_per_s: float | None
    ideal_reversals_per_s: float | None


NO_CHATTER_KNOWN = Chatter(None, None, None, None)


def chatter(time_s: Array, command_n: Array, ideal_n: Array) -> Chatter:
    """TVx, HF5 and REV of a command beside the ideal one, sampled at the same equally spaced instants (n).

    Only what is `START_S` or more after the first instant counts.
    """
    if len(time_s) < 2:
        return NO_CHATTER_KNOWN
    counted = time_s >= time_s[0] + START_S
    time_s, command_n, ideal_n = time_s[counted], command_n[counted], ideal_n[counted]
    if len(time_s) < 2 or time_s[-1] - time_s[0] < 1.0:
        return NO_CHATTER_KNOWN
    duration_s = float(time_s[-1] - time_s[0])
    step_s = duration_s / (len(time_s) - 1)
    return Chatter(
        excess_variation_n_per_s=(total_variation(command_n) - total_variation(ideal_n)) / duration_s,
        ripple_n=ripple(command_n, step_s),
        reversals_per_s=reversals(command_n) / duration_s,
        ideal_reversals_per_s=reversals(ideal_n) / duration_s,
    )


def total_variation(values: Array) -> float:
    """Sum of all changes, without sign."""
    return float(np.sum(np.abs(np.diff(values))))


def ripple(values: Array, step_s: float, cut_off_hz: float = HIGH_PASS_HZ) -> float | None:
    """RMS of what lies above `cut_off_hz`: Butterworth high-pass of 4th order, run forward and backward.

    None where the samples are too few, or too slow to hold such a frequency.
    """
    from scipy.signal import butter, sosfiltfilt

    nyquist_hz = 0.5 / step_s
    sections = HIGH_PASS_ORDER // 2
    if cut_off_hz >= nyquist_hz or len(values) <= 3 * (2 * sections + 1):
        return None
    high_pass = butter(HIGH_PASS_ORDER, cut_off_hz / nyquist_hz, "highpass", output="sos")
    return float(np.sqrt(np.mean(sosfiltfilt(high_pass, values) ** 2)))


def reversals(values: Array, travel: float = TURN_N) -> int:
    """Turning points after which the signal comes back by more than `travel`: a count with hysteresis.

    The first movement is no turning point.
    """
    count, direction = 0, 0
    low = high = float(values[0])
    for value in values.tolist():
        if direction >= 0:
            high = max(high, value)
            if value < high - travel:
                count += direction > 0
                direction, low = -1, value
        if direction <= 0:
            low = min(low, value)
            if value > low + travel:
                count += direction < 0
                direction, high = 1, value
    return count


def ideal_force_n(reference_acceleration_mps2: Array, resistance_n: Array, effective_mass_kg: float) -> Array:
    """u*: the force that gives the true train just the reference's acceleration (ideal inverse dynamics).

    `resistance_n` is all that acts on the true train now, positive against the travel, disturbances too.
    """
    force: Array = effective_mass_kg * reference_acceleration_mps2 + resistance_n
    return force


def commanded_force_n(
    demand: Array, speed_mps: Array, traction_n: Callable[[float], float], service_brake_n: float
) -> Array:
    """What a demand in [-1, 1] asks for [N]: a share of the tractive effort at that speed, or of the brake.

    `traction_n` is the available tractive effort at a speed.
    """
    available = np.array([traction_n(max(0.0, speed)) for speed in speed_mps.tolist()])
    force: Array = np.where(demand >= 0.0, demand * available, demand * service_brake_n)
    return force
