"""How long a process of the bench may take to start; longer on a slow machine, an emulated one say."""

from __future__ import annotations

import math
import os

from hil.node.options import OptionsError

__all__ = ["START_LIMIT_S", "VARIABLE", "start_limit_s"]

START_LIMIT_S = 60.0
"""The first start compiles numeric kernels; later starts take a second or two."""
VARIABLE = "HIL_START_TIMEOUT_S"


def start_limit_s() -> float:
    """60 s, or what the environment variable HIL_START_TIMEOUT_S says.

    Raises OptionsError when that is no number of seconds greater than 0.
    """
    text = os.environ.get(VARIABLE)
    if not text:
        return START_LIMIT_S
    try:
        limit_s = float(text)
    except ValueError:
        limit_s = math.nan
    if not (math.isfinite(limit_s) and limit_s > 0.0):
        raise OptionsError(f"{VARIABLE}={text}: must be a number of seconds greater than 0")
    return limit_s
