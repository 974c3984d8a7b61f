"""Peaks of a speed profile cut to a plateau: the train never goes straight from traction to brake."""

from __future__ import annotations

import numpy as np

from controller.profile.profile import Floats

FLAT_MPS = 1e-9
"""Speeds of neighbouring nodes closer than this are the same cruising speed."""
CRUISE_MPS2 = 0.1
"""Accelerations smaller than this count as cruising or coasting."""


def with_plateaus(mesh: Floats, speed: Floats, window_s: float) -> Floats:
    """Cut every peak between accelerating and braking so that its top lasts `window_s`."""
    speed = speed.copy()
    interval = np.diff(speed**2) / (2.0 * np.diff(mesh))
    rising = interval > CRUISE_MPS2
    falling = interval < -CRUISE_MPS2
    k = 0
    last = len(interval)
    while k < last:
        if not rising[k]:
            k += 1
            continue
        while k < last and rising[k]:
            k += 1
        top = k  # node at which the rise ends
        fall = top
        while fall < last and not falling[fall] and not rising[fall]:
            fall += 1
        if fall >= last or rising[fall]:
            continue
        between = slice(top, fall + 1)
        pause = float(np.sum(2.0 * np.diff(mesh[between]) / (speed[between][1:] + speed[between][:-1])))
        if pause < window_s:
            _cut(mesh, speed, top, fall, window_s)
    return speed


def _cut(mesh: Floats, speed: Floats, top: int, fall: int, window_s: float) -> None:
    """Lower the peak at nodes `top`..`fall` in place to the highest level that lasts `window_s`."""
    low, high = 0.0, float(max(speed[top], speed[fall]))
    for _ in range(40):
        level = 0.5 * (low + high)
        left, right = _above(speed, top, fall, level)
        if mesh[right] - mesh[left] >= level * window_s:
            low = level
        else:
            high = level
    left, right = _above(speed, top, fall, low)
    speed[left : right + 1] = np.minimum(speed[left : right + 1], low)


def _above(speed: Floats, top: int, fall: int, level: float) -> tuple[int, int]:
    """First and last node of the peak that lie at or above `level`; not beyond a valley."""
    left, right = top, fall
    while left > 0 and level <= speed[left - 1] <= speed[left] + FLAT_MPS:
        left -= 1
    while right < len(speed) - 1 and level <= speed[right + 1] <= speed[right] + FLAT_MPS:
        right += 1
    return left, right
