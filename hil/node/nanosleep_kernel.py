"""clock_nanosleep and clock_gettime of the C library, one right after the other; 64-bit Linux only."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

__all__ = ["sleep_until"]

NS_PER_S = 1_000_000_000
CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1

_t: Any = types  # its stubs know types as classes only
_nanosleep = _t.ExternalFunction("clock_nanosleep", _t.int32(_t.int32, _t.int32, _t.uintp, _t.uintp))
_gettime = _t.ExternalFunction("clock_gettime", _t.int32(_t.int32, _t.uintp))


@njit("int64(int64, int64[::1])", nogil=True, cache=True)
def sleep_until(at_ns: int, timespec: NDArray[np.int64]) -> int:
    """Sleep until `at_ns` of CLOCK_MONOTONIC, or a signal; that clock's time then [ns].

    `timespec` (2,) is working memory: a struct timespec of two longs.
    """
    timespec[0] = at_ns // NS_PER_S
    timespec[1] = at_ns % NS_PER_S
    _nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec.ctypes.data, 0)
    _gettime(CLOCK_MONOTONIC, timespec.ctypes.data)
    return timespec[0] * NS_PER_S + timespec[1]  # type: ignore[no-any-return]
