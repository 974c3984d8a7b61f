"""Ticks of an axis, and numbers as they stand beside it."""

from __future__ import annotations

import math

__all__ = ["decades", "plain", "ticks"]

TICKS = 5


def ticks(low: float, high: float) -> list[float]:
    """Round numbers between low and high, about TICKS: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def decades(low: float, high: float) -> list[float]:
    """Powers of ten from low to high, both included."""
    return [
        10.0**k for k in range(math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9) + 1)
    ]


def plain(value: float) -> str:
    """A number as axes have it: thin spaces between thousands, a proper minus."""
    text = f"{round(value, 9):.6g}"
    if "e" in text or abs(value) >= 1e4:
        text = f"{value:,.0f}".replace(",", "\u202f")
    return text.replace("-", "\u2212")
