"""What a run is judged by: pure functions over arrays of a recorded run. SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STANDSTILL_MPS = 0.005
"""Below this speed the train counts as standing: twice the 0.01 km/h step of a usual odometer."""

JERK_AVERAGE_S = 0.2
JERK_DIFFERENCE_S = 0.1


@dataclass(frozen=True)
class Truth:
    """What the train really did, one value per plant cycle (arrays of one length)."""

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    permitted_speed_mps: Array
    traction_energy_j: Array
    regenerated_energy_j: Array


@dataclass(frozen=True)
class Tracking:
    """What the controller followed, one value per controller cycle, while it drove."""

    time_s: Array
    reference_speed_mps: Array


@dataclass(frozen=True)
class ControlMetrics:
    """Quality of control over one run; `None` where the run did not get that far."""

    rms_speed_error_mps: float | None
    max_speed_error_mps: float | None
    max_overspeed_mps: float | None
    stop_error_m: float | None
    max_jerk_mps3: float | None
    acceleration_at_standstill_mps2: float | None
    trip_time_s: float | None
    traction_energy_j: float | None
    regenerated_energy_j: float | None


def control_metrics(truth: Truth, tracking: Tracking, *, stop_position_m: float) -> ControlMetrics:
    """Judge one run from departure to standstill.

    The speed error is reference minus true speed at the instants at which the controller used
    that reference. The stop error is positive past the stop point.
    """
    if len(truth.time_s) < 3:
        return ControlMetrics(*(None,) * 9)
    errors = speed_errors(truth, tracking)
    stop = standstill_index(truth)
    arrived = stop is not None and len(tracking.time_s) > 0
    return ControlMetrics(
        rms_speed_error_mps=float(np.sqrt(np.mean(errors**2))) if len(errors) else None,
        max_speed_error_mps=float(np.max(np.abs(errors))) if len(errors) else None,
        max_overspeed_mps=float(np.max(np.abs(truth.speed_mps) - truth.permitted_speed_mps)),
        stop_error_m=float(truth.position_m[-1] - stop_position_m) if arrived else None,
        max_jerk_mps3=max_jerk_mps3(truth.time_s, truth.acceleration_mps2),
        acceleration_at_standstill_mps2=_last_moving(truth, stop) if stop is not None else None,
        trip_time_s=float(truth.time_s[stop] - tracking.time_s[0]) if arrived and stop is not None else None,
        traction_energy_j=float(truth.traction_energy_j[-1]),
        regenerated_energy_j=float(truth.regenerated_energy_j[-1]),
    )


def speed_errors(truth: Truth, tracking: Tracking) -> Array:
    """Reference minus true speed [m/s] at the controller's instants."""
    if not len(tracking.time_s):
        return np.empty(0)
    true_speed = np.interp(tracking.time_s, truth.time_s, truth.speed_mps)
    errors: Array = tracking.reference_speed_mps - true_speed
    return errors


def standstill_index(truth: Truth) -> int | None:
    """Index of the first sample of the final standstill; None if the train never ran or never stopped."""
    moving = np.flatnonzero(np.abs(truth.speed_mps) > STANDSTILL_MPS)
    if not len(moving) or moving[-1] + 1 >= len(truth.speed_mps):
        return None
    return int(moving[-1] + 1)


def max_jerk_mps3(time_s: Array, acceleration_mps2: Array) -> float | None:
    """Largest jerk [m/s^3]: 0.2 s moving average of the acceleration, differenced over 0.1 s.

    The moment of standstill counts. Samples must be equally spaced but for skipped cycles, which
    are filled by interpolation.
    """
    step = float(np.median(np.diff(time_s)))
    if step <= 0 or time_s[-1] - time_s[0] < JERK_AVERAGE_S + JERK_DIFFERENCE_S:
        return None
    grid = np.arange(time_s[0], time_s[-1], step)
    acceleration = np.interp(grid, time_s, acceleration_mps2)
    window = max(1, round(JERK_AVERAGE_S / step))
    lag = max(1, round(JERK_DIFFERENCE_S / step))
    average = np.convolve(acceleration, np.full(window, 1.0 / window), mode="valid")
    return float(np.max(np.abs(average[lag:] - average[:-lag])) / (lag * step))


def percentiles_us(values_us: Array) -> dict[str, float]:
    """p50, p99, p99.9 and maximum [us] of a timing series."""
    if not len(values_us):
        return {"p50": 0.0, "p99": 0.0, "p999": 0.0, "max": 0.0}
    p50, p99, p999 = np.percentile(values_us, [50, 99, 99.9])
    return {
        "p50": round(float(p50), 2),
        "p99": round(float(p99), 2),
        "p999": round(float(p999), 2),
        "max": round(float(np.max(values_us)), 2),
    }


def _last_moving(truth: Truth, stop: int) -> float:
    return float(abs(truth.acceleration_mps2[max(0, stop - 1)]))
