"""Peaks of a speed profile cut to a plateau: the train never goes straight from traction to brake."""

from __future__ import annotations

from math import sqrt

import numpy as np

from controller.profile.profile import Floats

ALLOWANCE = 0.04
"""A step larger than allowed by this share gets a whole window, a smaller one a part of it.

So the time of a run is a continuous function of its speeds, and a timetable can be met."""
FLAT_MPS2 = 1e-6
FLAT_J_PER_KG = 1e-6
"""Differences this small count as none."""


def with_plateaus(mesh: Floats, speed: Floats, window_s: float, step_mps2: float) -> tuple[Floats, Floats]:
    """Cut every peak across which the acceleration falls by more than `step_mps2` within `window_s`.

    The cut peak keeps one speed for `window_s`. Returns positions and speeds (shapes n), with two nodes more
    and those between them fewer for each cut. The acceleration between two nodes is constant.
    """
    x, y = mesh, 0.5 * speed**2
    first = 0
    while True:
        peak, largest = _steep_peak(x, y, window_s, step_mps2, first)
        if peak < 0:
            return x, np.sqrt(2.0 * y)
        share = min(1.0, (largest / step_mps2 - 1.0) / ALLOWANCE)
        x, y, first = _cut(x, y, peak, share * window_s)


def _steep_peak(x: Floats, y: Floats, window_s: float, step: float, first: int) -> tuple[int, float]:
    """Index of the first node from `first` on that is such a peak, and its step; -1: none."""
    acceleration = np.diff(y) / np.diff(x)
    speed = np.sqrt(2.0 * y)
    took = 2.0 * np.diff(x) / (speed[1:] + speed[:-1])
    rising, falling = acceleration > FLAT_MPS2, acceleration < -FLAT_MPS2
    for k in np.flatnonzero(rising[:-1] & ~rising[1:]) + 1:
        top = fall = int(k)
        if top < first:
            continue
        pause = 0.0
        while fall < len(took) and not falling[fall] and not rising[fall]:
            pause += float(took[fall])
            fall += 1
        if fall >= len(took) or rising[fall]:
            continue
        # every pair of a rise and a fall less than a window apart
        largest = 0.0
        before, gap_before = top - 1, pause
        while before >= 0 and rising[before] and gap_before < window_s:
            after, gap = fall, gap_before
            while after < len(took) and falling[after] and gap < window_s:
                largest = max(largest, float(acceleration[before] - acceleration[after]))
                gap += float(took[after])
                after += 1
            gap_before += float(took[before])
            before -= 1
        if largest > step:
            return top, largest
    return -1, 0.0


def _cut(x: Floats, y: Floats, peak: int, window_s: float) -> tuple[Floats, Floats, int]:
    """Lower the peak to the highest level that lasts `window_s`; also the index of the plateau's end.

    The first and the last node stay: a peak too near to one of them is cut as far as that allows.
    """
    left, right = _crossings(x, y, peak, 0.0)
    low = max(float(y[0]) if left == x[0] else 0.0, float(y[-1]) if right == x[-1] else 0.0)
    high = max(low, float(y[peak]))
    for _ in range(60):
        level = 0.5 * (low + high)
        left, right = _crossings(x, y, peak, level)
        low, high = (level, high) if right - left >= sqrt(2.0 * level) * window_s else (low, level)
    left, right = _crossings(x, y, peak, low)
    before, after = x < left, x > right
    positions = np.concatenate((x[before], [left, right], x[after]))
    energies = np.concatenate((y[before], [low, low], y[after]))
    return positions, energies, int(np.count_nonzero(before)) + 1


def _crossings(x: Floats, y: Floats, peak: int, level: float) -> tuple[float, float]:
    """Where the profile around the peak leaves `level`; not beyond a valley."""
    left, right = peak, peak
    while left > 0 and level <= y[left - 1] <= y[left] + FLAT_J_PER_KG:
        left -= 1
    while right < len(y) - 1 and level <= y[right + 1] <= y[right] + FLAT_J_PER_KG:
        right += 1
    start, end = float(x[left]), float(x[right])
    if left > 0 and y[left - 1] < level:
        start -= float((y[left] - level) / (y[left] - y[left - 1]) * (x[left] - x[left - 1]))
    if right < len(y) - 1 and y[right + 1] < level:
        end += float((y[right] - level) / (y[right] - y[right + 1]) * (x[right + 1] - x[right]))
    return start, end
