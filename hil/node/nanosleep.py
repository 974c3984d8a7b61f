"""Sleeping until an absolute time in machine code, so that the time of waking is read right after it.

A loop that has slept for milliseconds finds its caches cold. What Python does between the end of a sleep and
the next reading of the clock then takes 15 to 20 us, a third of what the wake-up takes altogether.
"""

from __future__ import annotations

import struct
import sys
import time
from collections.abc import Callable

__all__ = ["sleeper"]

NS_PER_S = 1_000_000_000


def sleeper(*, compiled: bool | None = None) -> Callable[[int], int]:
    """What sleeps until a moment of `time.monotonic_ns` [ns] and returns that clock's time then [ns].

    It may return early when a signal came, whose handler then runs; a moment that has passed does not sleep.
    `compiled`: in machine code (64-bit Linux only), or with `time.sleep`; None: as the system allows.
    """
    if compiled is None:
        compiled = sys.platform.startswith("linux") and struct.calcsize("P") == struct.calcsize("l") == 8
    return _compiled() if compiled else _plain


def _plain(at_ns: int) -> int:
    left_ns = at_ns - time.monotonic_ns()
    if left_ns > 0:
        time.sleep(left_ns / NS_PER_S)
    return time.monotonic_ns()


def _compiled() -> Callable[[int], int]:
    import numpy as np

    from hil.node.nanosleep_kernel import sleep_until

    timespec = np.zeros(2, np.int64)

    def sleep(at_ns: int) -> int:
        woke_ns: int = sleep_until(at_ns, timespec)
        return woke_ns

    sleep(0)
    return sleep
