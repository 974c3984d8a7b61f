"""The table of a study: what the paper prints, what this program gets, and whether that is the same.

Nobody writes "reproduced" by hand: a row declares its tolerance and the two numbers decide.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["Row", "Tolerance", "ratio", "row_json", "summary_line"]


@dataclass(frozen=True)
class Tolerance:
    """How far from the paper's number counts as the same: the larger of `relative` and `absolute`.

    `relative` is a fraction of the paper's number, `absolute` is in the row's unit (half of the last digit
    that the paper prints is a good choice).
    """

    relative: float = 0.0
    absolute: float = 0.0

    def __post_init__(self) -> None:
        if not (self.relative >= 0.0 and self.absolute >= 0.0):
            raise ValueError(f"tolerance: relative {self.relative} and absolute {self.absolute} must be >= 0")

    def accepts(self, paper: float, ours: float) -> bool:
        """Whether `ours` is the paper's number, within this tolerance; never for a non-finite number."""
        return abs(ours - paper) <= max(self.relative * abs(paper), self.absolute)

    def __str__(self) -> str:
        parts = [f"{100.0 * self.relative:g} %"] * (self.relative > 0.0)
        parts += [f"{self.absolute:g}"] * (self.absolute > 0.0)
        return " or ".join(parts) or "exactly"


@dataclass(frozen=True)
class Row:
    """One line of the table.

    `paper` is None where the paper prints nothing to compare with, `ours` None where there is nothing to
    compute. Without a `tolerance` the row is told beside the others and not judged: a physical train's
    number, say. `group` is the heading it stands under; `note` says why, and what was assumed.
    """

    quantity: str
    unit: str
    paper: float | None
    ours: float | None
    tolerance: Tolerance | None = None
    note: str = ""
    group: str = ""

    @property
    def reproduced(self) -> bool | None:
        """Whether ours is the paper's within the tolerance; None where there is nothing to judge."""
        if self.tolerance is None or self.paper is None or self.ours is None:
            return None
        return self.tolerance.accepts(self.paper, self.ours)

    @property
    def ratio(self) -> float | None:
        """Ours over the paper's; None without one of them, or with a paper's zero."""
        return ratio(self.ours, self.paper)


def ratio(ours: float | None, paper: float | None) -> float | None:
    """`ours / paper`, or None where that has no meaning."""
    if ours is None or paper is None or paper == 0.0:
        return None
    return ours / paper


def row_json(row: Row) -> Mapping[str, Any]:
    """A row as it stands in study.json: plain values, None where there is none."""
    tolerance = row.tolerance
    return {
        "quantity": row.quantity,
        "unit": row.unit,
        "paper": _number(row.paper),
        "ours": _number(row.ours),
        "ratio": _number(row.ratio),
        "reproduced": row.reproduced,
        "tolerance": None if tolerance is None else str(tolerance),
        "note": row.note,
        "group": row.group,
    }


def summary_line(rows: Iterable[Row]) -> str:
    """How much of what the paper claims was reproduced: `7 of 12 numbers reproduced`."""
    judged = [row.reproduced for row in rows if row.reproduced is not None]
    if not judged:
        return "nothing to judge: the paper prints no number of its result"
    return f"{sum(judged)} of {len(judged)} numbers reproduced"


def _number(value: float | None) -> float | None:
    """JSON knows neither NaN nor infinity."""
    return float(value) if value is not None and math.isfinite(value) else None
