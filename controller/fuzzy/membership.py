"""Membership functions: triangle, shoulder and trapezoid, all of them one shape of four corners.

A grade is 1 on the closed plateau from `top_left` to `top_right`, 0 outside the feet and linear between.
An upright edge (foot = plateau's end) is allowed; the grade on the edge itself is 1, as in scikit-fuzzy's
`trimf` and `trapmf`. A shoulder goes on to infinity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass


class RuleBaseError(ValueError):
    """A rule base is not complete or not well formed: names variable, term and value."""

    exit_code = 2


@dataclass(frozen=True)
class Trapezoid:
    """Left foot, both ends of the plateau, right foot; in the unit of the variable it belongs to.

    RuleBaseError unless they ascend, leave a width, and are finite; a shoulder's outer two are infinite.
    """

    left: float
    top_left: float
    top_right: float
    right: float

    def __post_init__(self) -> None:
        corners = self.corners
        if any(math.isnan(x) for x in corners) or list(corners) != sorted(corners):
            raise RuleBaseError(f"membership function: corners {_text(corners)} must ascend")
        if not self.left < self.right:
            raise RuleBaseError(f"membership function: corners {_text(corners)} leave no width")
        if math.isinf(self.left) != math.isinf(self.top_left) or math.isinf(self.right) != math.isinf(
            self.top_right
        ):
            raise RuleBaseError(
                f"membership function: corners {_text(corners)} must be finite, or both infinite on the side "
                "of a shoulder"
            )
        if math.isinf(self.left) and math.isinf(self.right):
            raise RuleBaseError("membership function: a shoulder on both sides is true everywhere")

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left foot, plateau from and to, right foot."""
        return self.left, self.top_left, self.top_right, self.right

    def grade(self, value: float) -> float:
        """Membership of a value, 0 to 1."""
        if self.top_left <= value <= self.top_right:
            return 1.0
        if not self.left < value < self.right:
            return 0.0
        if value < self.top_left:
            return (value - self.left) / (self.top_left - self.left)
        return (self.right - value) / (self.right - self.top_right)

    def limits(self, start: float, end: float) -> tuple[float, float]:
        """Grades towards both ends of an interval from inside it; no corner may lie strictly inside."""
        middle = 0.5 * (start + end)
        if self.top_left <= middle <= self.top_right:
            return 1.0, 1.0
        if not self.left < middle < self.right:
            return 0.0, 0.0
        if middle < self.top_left:
            width = self.top_left - self.left
            return (start - self.left) / width, (end - self.left) / width
        width = self.right - self.top_right
        return (self.right - start) / width, (self.right - end) / width


def triangle(left: float, peak: float, right: float) -> Trapezoid:
    """A triangle; one foot may be the peak."""
    return Trapezoid(left, peak, peak, right)


def left_shoulder(top: float, foot: float) -> Trapezoid:
    """1 up to `top`, 0 from `foot` on."""
    return Trapezoid(-math.inf, -math.inf, top, foot)


def right_shoulder(foot: float, top: float) -> Trapezoid:
    """0 up to `foot`, 1 from `top` on."""
    return Trapezoid(foot, top, math.inf, math.inf)


def partition(peaks: tuple[float, ...]) -> tuple[Trapezoid, ...]:
    """Triangles that reach zero at their neighbours' peaks, shoulders at both ends: grades sum to one."""
    inner = (triangle(*peaks[k - 1 : k + 2]) for k in range(1, len(peaks) - 1))
    return (left_shoulder(peaks[0], peaks[1]), *inner, right_shoulder(peaks[-2], peaks[-1]))


def _text(corners: tuple[float, ...]) -> str:
    return ", ".join(f"{x:g}" for x in corners)
