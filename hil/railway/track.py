"""Track resistance as plain arrays: piecewise constant in position, its integral piecewise linear.

The mean over a train is a difference of the integral at its two ends, divided by its length: exact,
and two look-ups. `integral_at` and `mean_over_train` use nothing but arrays and arithmetic, so a
node may compile them as they stand: `numba.njit(integral_at)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TrackResistance:
    """Specific resistance [N/kN] along the line: gradient, curve and tunnel summed; zero outside.

    Shapes: `edges_m` (n+1) ascending, `specific_n_per_kn` (n) between the edges, `integral_m`
    (n+1) its integral from the first edge [N/kN m], so `integral_m[0]` is 0. All read-only.
    """

    edges_m: FloatArray
    specific_n_per_kn: FloatArray
    integral_m: FloatArray

    @classmethod
    def from_steps(cls, edges_m: FloatArray, specific_n_per_kn: FloatArray) -> TrackResistance:
        """Arrays with the integral added, set read-only."""
        integral = np.concatenate(([0.0], np.cumsum(np.diff(edges_m) * specific_n_per_kn)))
        for array in (edges_m, specific_n_per_kn, integral):
            array.setflags(write=False)
        return cls(edges_m, specific_n_per_kn, integral)

    def at(self, position_m: float) -> float:
        """Specific resistance [N/kN] at one point; a step belongs to the section that begins there."""
        index = int(np.searchsorted(self.edges_m, position_m, side="right")) - 1
        if index < 0 or index >= len(self.specific_n_per_kn):
            return 0.0
        return float(self.specific_n_per_kn[index])

    def mean(self, front_m: float, length_m: float) -> float:
        """Specific resistance [N/kN] averaged over a train of uniform mass; a point if length is 0."""
        if length_m <= 0.0:
            return self.at(front_m)
        return mean_over_train(self.edges_m, self.integral_m, front_m, length_m)


def integral_at(edges_m: FloatArray, integral_m: FloatArray, position_m: float) -> float:
    """Integral of the specific resistance up to a position [N/kN m]; constant outside the edges."""
    last = len(edges_m) - 1
    if position_m <= edges_m[0]:
        return integral_m[0]  # type: ignore[no-any-return]  # float64, which is a float
    if position_m >= edges_m[last]:
        return integral_m[last]  # type: ignore[no-any-return]
    low = 0
    high = last
    while high - low > 1:
        middle = (low + high) // 2
        if edges_m[middle] <= position_m:
            low = middle
        else:
            high = middle
    part = (position_m - edges_m[low]) / (edges_m[high] - edges_m[low])
    return integral_m[low] + part * (integral_m[high] - integral_m[low])  # type: ignore[no-any-return]


def mean_over_train(edges_m: FloatArray, integral_m: FloatArray, front_m: float, length_m: float) -> float:
    """Mean specific resistance [N/kN] between `front_m - length_m` and `front_m`; length above 0."""
    front = integral_at(edges_m, integral_m, front_m)
    rear = integral_at(edges_m, integral_m, front_m - length_m)
    return float((front - rear) / length_m)
