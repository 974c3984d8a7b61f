"""A curve with fewer points that looks the same: first, lowest, highest and last of every column."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["COLUMNS", "decimate"]

Array = NDArray[np.float64]
COLUMNS = 600
"""Columns of a picture: more than a phone has, half of what a large page has."""


def decimate(x: Array, y: Array, columns: int = COLUMNS, *, step: bool = False) -> tuple[Array, Array]:
    """At most about four points per column, in the order in which they came; every extreme is kept.

    Samples that are not finite are left out. `step`: the curve holds each value until the next.
    """
    finite = np.isfinite(x) & np.isfinite(y)
    x, y = x[finite], y[finite]
    if len(x) <= 2 * columns or x.max() == x.min():
        return x, y
    column = np.minimum((x - x.min()) / (x.max() - x.min()) * columns, columns - 1).astype(np.int64)
    starts = np.concatenate(([0], np.flatnonzero(np.diff(column)) + 1))
    ends = np.append(starts[1:], len(x))
    kept: set[int] = set()
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        part = y[start:end]
        kept |= {start, start + int(part.argmin()), start + int(part.argmax()), end - 1}
    rows = np.array(sorted(kept))
    if step:
        return x[rows], y[rows]
    # What lies on a straight line between its neighbours is not seen.
    turn = np.ones(len(rows), bool)
    run, rise = np.diff(x[rows]), np.diff(y[rows])
    turn[1:-1] = np.abs(run[:-1] * rise[1:] - run[1:] * rise[:-1]) > 1e-12
    return x[rows[turn]], y[rows[turn]]
