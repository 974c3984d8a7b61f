"""What makes a speed-profile problem not convex: notches, efficiency maps, neutral sections.

With any of these a mix of two good profiles need not be a profile at all, or not a good one: such a problem
is for dynamic programming, not for the interior point.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from controller.profile.profile import Floats, ProfileError


@dataclass(frozen=True)
class EfficiencyMap:
    """Efficiency over speed and effort: `table[i][j]` at `speeds_mps[i]` and `efforts_n[j]`, linear between.

    Beyond the ends the nearest value holds. Efforts are positive, for traction and for braking alike.
    Traction efficiencies are above 0 and at most 1, regeneration efficiencies from 0 (below a threshold
    nothing comes back) to below 1. ProfileError where a value is out of range or the axes do not ascend.
    """

    speeds_mps: tuple[float, ...]
    efforts_n: tuple[float, ...]
    traction: tuple[tuple[float, ...], ...]
    regeneration: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        for name in ("speeds_mps", "efforts_n"):
            axis = getattr(self, name)
            if len(axis) < 2 or any(not low < high for low, high in pairwise(axis)):
                raise ProfileError(f"efficiency map: {name} needs at least two values, ascending")
        for name in ("traction", "regeneration"):
            table = getattr(self, name)
            if len(table) != len(self.speeds_mps) or any(len(row) != len(self.efforts_n) for row in table):
                raise ProfileError(
                    f"efficiency map: {name} needs {len(self.speeds_mps)} rows of {len(self.efforts_n)}"
                )
        for row in self.traction:
            for value in row:
                if not 0.0 < value <= 1.0:
                    raise ProfileError(f"efficiency map: traction: {value:g} must be above 0 and at most 1")
        for row in self.regeneration:
            for value in row:
                if not 0.0 <= value < 1.0:
                    raise ProfileError(f"efficiency map: regeneration: {value:g} must be from 0 to below 1")

    def line_force_n(self, speed_mps: Floats, traction_n: Floats, regenerative_n: Floats) -> Floats:
        """Energy at the line per metre [N] of these efforts at these speeds (arrays of one shape)."""
        speeds, efforts = np.array(self.speeds_mps), np.array(self.efforts_n)
        drawn, given = np.array(self.traction), np.array(self.regeneration)
        return np.array(
            [
                t / efficiency_at(speeds, efforts, drawn, v, t)
                - r * efficiency_at(speeds, efforts, given, v, r)
                for v, t, r in zip(speed_mps, traction_n, regenerative_n, strict=True)
            ]
        )


@dataclass(frozen=True)
class DriveMap:
    """Properties of drive and line that no convex problem has; every one may be left out.

    `notches_n`: the only tractive efforts that the drive gives [N], ascending; braking stays continuous.
    `neutral_sections_m`: (from, to), in distance travelled, where there is neither traction nor
    regeneration. `efficiency` takes the place of the problem's two constant efficiencies.
    """

    notches_n: tuple[float, ...] = ()
    neutral_sections_m: tuple[tuple[float, float], ...] = ()
    efficiency: EfficiencyMap | None = None

    def __post_init__(self) -> None:
        if any(not low < high for low, high in pairwise((0.0, *self.notches_n))):
            raise ProfileError("drive map: notches_n must ascend from above 0")
        for start, end in self.neutral_sections_m:
            if not start < end:
                raise ProfileError(f"drive map: neutral section: {start:g} m must be before {end:g} m")

    def neutral_stages(self, position_m: Floats) -> NDArray[np.bool_]:
        """Which stages between these nodes are neutral: those whose middle is."""
        middle = 0.5 * (position_m[1:] + position_m[:-1])
        neutral = np.zeros(len(middle), dtype=np.bool_)
        for start, end in self.neutral_sections_m:
            neutral |= (middle > start) & (middle < end)
        return neutral

    def arrays(self, position_m: Floats, mass_kg: float) -> DriveArrays:
        """As plain arrays per kilogram of effective mass."""
        given = self.efficiency
        return DriveArrays(
            neutral=self.neutral_stages(position_m),
            notches=np.array(self.notches_n, dtype=np.float64) / mass_kg,
            mapped=given is not None,
            speeds=np.array(given.speeds_mps if given else (0.0, 1.0), dtype=np.float64),
            efforts=np.array(given.efforts_n if given else (0.0, 1.0), dtype=np.float64) / mass_kg,
            traction=np.array(given.traction if given else ((1.0, 1.0),) * 2, dtype=np.float64),
            regeneration=np.array(given.regeneration if given else ((0.0, 0.0),) * 2, dtype=np.float64),
        )


class DriveArrays(NamedTuple):
    """A drive map for compiled code. Shapes: `neutral` (N), `notches` (any), tables (speeds, efforts)."""

    neutral: NDArray[np.bool_]
    notches: Floats
    mapped: bool
    speeds: Floats
    efforts: Floats
    traction: Floats
    regeneration: Floats


@njit(cache=True)
def efficiency_at(speeds: Floats, efforts: Floats, table: Floats, speed: float, effort: float) -> float:
    """Bilinear value of an efficiency table, the nearest one outside."""
    i, p = _place(speeds, speed)
    j, q = _place(efforts, effort)
    low = table[i, j] + q * (table[i, j + 1] - table[i, j])
    high = table[i + 1, j] + q * (table[i + 1, j + 1] - table[i + 1, j])
    return low + p * (high - low)  # type: ignore[no-any-return]


@njit(cache=True)
def _place(axis: Floats, value: float) -> tuple[int, float]:
    last = axis.shape[0] - 2
    k = min(max(np.searchsorted(axis, value) - 1, 0), last)
    part = (value - axis[k]) / (axis[k + 1] - axis[k])
    return k, min(max(part, 0.0), 1.0)
