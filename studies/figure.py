"""Figures as data, panels and lines: drawn by `studies.draw`, recorded by `studies.recording`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Axis", "Figure", "Floats", "Line", "Panel", "Role", "thin"]

Floats = NDArray[np.float64]

Role = Literal["reference", "limit", "disturbance", "ideal", "a", "b", "c", "d", "e"]
"""What a line is, which decides its looks in every figure: the reference and the limits always look the
same; `a` to `e` are what was measured, one for each law."""

Axis = Literal["time_s", "position_m", "other"]
"""What runs along the horizontal axis; `other` figures are drawn but have no timeline in the recording."""


@dataclass(frozen=True)
class Line:
    """One line: `x` and `y` of equal shape (n). `step` holds each value until the next."""

    label: str
    role: Role
    x: Floats
    y: Floats
    step: bool = False


@dataclass(frozen=True)
class Panel:
    """One coordinate system. `y_limits` and `x_limits` where the data alone would not show the point."""

    title: str
    y_label: str
    lines: Sequence[Line]
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None
    log_y: bool = False


@dataclass(frozen=True)
class Figure:
    """One picture file. `name` is its stem; `paper` says which figure of the paper it stands beside.

    Panels stand one below the other, or in `columns` beside one another.
    """

    name: str
    title: str
    axis: Axis
    x_label: str
    panels: Sequence[Panel]
    paper: str = ""
    columns: int = 1


def thin(x: Floats, y: Floats, most: int = 4000) -> tuple[Floats, Floats]:
    """At most about `most` points that look the same: lowest and highest value of every stretch, in order.

    `x` and `y` are (n). Chatter keeps its width, which every n-th point would not show.
    """
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), most // 2 + 1).astype(np.int64)
    keep = {0, len(x) - 1}
    for start, end in pairwise(edges):
        part = y[start:end]
        keep |= {int(start + np.argmin(part)), int(start + np.argmax(part))}
    chosen = np.array(sorted(keep))
    return x[chosen], y[chosen]
