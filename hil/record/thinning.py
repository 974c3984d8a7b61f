"""Which samples a picture needs: a line through the chosen ones looks like the line through all.

A recording of an hour has a million samples of a signal, a screen a thousand pixels. Kept are the ends of
everything straight within a tolerance (constant stretches and steps among it), and of what is noise the
lowest and the highest of every few samples. No value is changed or made up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["NOISE_SAMPLES", "TOLERANCE", "Thinner", "kept_rows"]

TOLERANCE = 1e-3
"""Of the range of a signal so far: a pixel of a plot a thousand pixels high."""

NOISE_SAMPLES = 48
"""Where a line cannot be thinned within the tolerance, this many samples give two, of half a second."""

HELD_TOLERANCE = 5e-3
"""Of the range so far, for what is drawn in steps: a ramp over all of it is 200 steps."""

LARGEST_STRETCH = 1536

Array = NDArray[np.float64]


def kept_rows(values: Array, tolerance: float) -> NDArray[np.intp]:
    """Rows, in order, that a line through `values` (n) needs, first and last among them.

    Stretches of 1536 samples that stay within `tolerance` of the chord between their ends keep the ends;
    others are halved, down to NOISE_SAMPLES; what then is not straight keeps its extremes, or, if it is
    constant but for some steps, both sides of each step.
    """
    count = len(values)
    if count <= 2:
        return np.arange(count)
    kept = np.zeros(count, bool)
    kept[[0, -1]] = True
    length = LARGEST_STRETCH
    starts = np.arange(0, count - 1, length)
    while len(starts):
        # A stretch ends where the next one begins: `length` + 1 samples, shorter at the end of the data.
        rows = np.minimum(starts[:, None] + np.arange(length + 1), count - 1)
        stretch = values[rows]
        span = np.maximum(rows[:, -1] - rows[:, 0], 1)
        share = (rows - rows[:, :1]) / span[:, None]
        chord = stretch[:, :1] + (stretch[:, -1:] - stretch[:, :1]) * share
        with np.errstate(invalid="ignore"):
            straight = np.max(np.abs(stretch - chord), axis=1) <= tolerance  # not-a-number: not straight
        kept[starts], kept[rows[:, -1]] = True, True
        if length == NOISE_SAMPLES:
            _keep_rough(kept, rows[~straight], stretch[~straight])
            break
        starts, length = starts[~straight], length // 2
        starts = np.concatenate((starts, starts + length))
        starts = np.sort(starts[starts < count - 1])
    return np.flatnonzero(kept)


def _keep_rough(kept: NDArray[np.bool_], rows: NDArray[np.intp], stretches: Array) -> None:
    """Of each stretch (rows and values (k, m)) both sides of its few steps, or its extremes."""
    if not len(rows):
        return
    steps = stretches[:, 1:] != stretches[:, :-1]
    few = np.count_nonzero(steps, axis=1) <= 2
    before = np.where(few[:, None] & steps)
    kept[rows[before[0], before[1]]] = True
    kept[rows[before[0], before[1] + 1]] = True
    noise, of_noise = rows[~few], np.nan_to_num(stretches[~few])
    if len(noise):
        each = np.arange(len(noise))
        kept[noise[each, np.argmin(of_noise, axis=1)]] = True
        kept[noise[each, np.argmax(of_noise, axis=1)]] = True


class Thinner:
    """Thins a signal block by block; the tolerance grows with the range that was seen.

    `held`: the signal is drawn in steps, not as a line; then every departure by HELD_TOLERANCE is kept.
    """

    def __init__(self, *, held: bool = False) -> None:
        self._held = held
        self._low, self._high = np.inf, -np.inf

    def rows(self, values: Array) -> NDArray[np.intp]:
        """Rows of a block that a picture needs."""
        known = values[np.isfinite(values)]
        if len(known):
            self._low, self._high = min(self._low, known.min()), max(self._high, known.max())
        span = self._high - self._low
        if self._held and np.isfinite(span) and span > 0 and len(values) > 2:
            level = np.floor((values - self._low) / (HELD_TOLERANCE * span))
            changed = np.flatnonzero(level[1:] != level[:-1]) + 1
            return np.unique(np.concatenate(([0], changed, [len(values) - 1])))
        return kept_rows(values, TOLERANCE * span if np.isfinite(span) else 0.0)
