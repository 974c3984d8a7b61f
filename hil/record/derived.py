"""Quantities that are computed beside a probe while it is recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Jerk"]

AVERAGE_S, DIFFERENCE_S = 0.2, 0.1


class Jerk:
    """Jerk [m/s^3] from an acceleration: its moving average over 0.2 s, differenced over 0.1 s.

    That is how the verdict takes it. Backward-looking, so that it can be computed block by block; as long as
    not enough samples are known it is 0.
    """

    def __init__(self, period_s: float) -> None:
        self._average = max(1, round(AVERAGE_S / period_s))
        self._lag = max(1, round(DIFFERENCE_S / period_s))
        self._span_s = self._lag * period_s
        self._known = np.empty(0)

    def add(self, acceleration_mps2: NDArray[np.float64]) -> NDArray[np.float64]:
        """The jerk at the next n samples."""
        needed = self._average + self._lag
        fill = needed - len(self._known)
        first = acceleration_mps2[:1] if not len(self._known) else self._known[:1]
        before = np.concatenate((np.repeat(first, fill), self._known)) if fill > 0 else self._known
        values = np.concatenate((before, acceleration_mps2))
        self._known = values[-needed:]
        sums = np.cumsum(np.concatenate(([0.0], values)))
        average = (sums[self._average :] - sums[: -self._average]) / self._average
        jerk: NDArray[np.float64] = (average[self._lag :] - average[: -self._lag]) / self._span_s
        return jerk[-len(acceleration_mps2) :]
