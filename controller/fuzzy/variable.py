"""A linguistic variable: its terms, their membership functions and the universe they stand on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from controller.fuzzy.membership import RuleBaseError, Trapezoid, partition

FIVE_TERMS = ("NB", "NS", "Z", "PS", "PB")
SEVEN_TERMS = ("NB", "NM", "NS", "Z", "PS", "PM", "PB")


@dataclass(frozen=True)
class Variable:
    """Terms and their peaks, ascending, in `unit`; from these alone come evenly overlapping triangles.

    `peaks` are where the terms are fully true, and their centres for the centre average. Without `shapes`
    each term is a triangle to its neighbours' peaks, the first and the last a shoulder; without `universe`
    (lowest and highest value) it runs from the first peak to the last. RuleBaseError on anything that is
    not finite, not in order or inconsistent.
    """

    name: str
    unit: str
    terms: tuple[str, ...]
    peaks: tuple[float, ...]
    shapes: tuple[Trapezoid, ...] = ()
    universe: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.terms) != len(self.peaks) or len(self.terms) < 2:
            raise RuleBaseError(
                f"variable {self.name}: {len(self.terms)} terms but {len(self.peaks)} peaks; "
                "give one peak for each of at least two terms"
            )
        if len(set(self.terms)) != len(self.terms):
            raise RuleBaseError(f"variable {self.name}: a term is named twice in {', '.join(self.terms)}")
        if self.universe:
            self._check_universe()
        self._check_peaks()
        if not self.shapes:
            object.__setattr__(self, "shapes", partition(self.peaks))
        if not self.universe:
            object.__setattr__(self, "universe", (self.peaks[0], self.peaks[-1]))
        self._check_shapes()

    @classmethod
    def symmetric(cls, name: str, unit: str, terms: Sequence[str], positive: Sequence[float]) -> Variable:
        """A variable symmetric about zero, given the peaks of its positive terms, ascending."""
        peaks = (*(-p for p in reversed(positive)), 0.0, *positive)
        return cls(name, unit, tuple(terms), peaks)

    @classmethod
    def shaped(
        cls, name: str, unit: str, universe: tuple[float, float], shapes: Mapping[str, Trapezoid]
    ) -> Variable:
        """A variable of any membership functions; its peaks are the middles of their plateaus inside."""
        low, high = universe
        peaks = tuple(0.5 * (max(s.top_left, low) + min(s.top_right, high)) for s in shapes.values())
        return cls(name, unit, tuple(shapes), peaks, tuple(shapes.values()), universe)

    @property
    def low(self) -> float:
        """Lowest value of the universe."""
        return self.universe[0]

    @property
    def high(self) -> float:
        """Highest value of the universe."""
        return self.universe[-1]

    def corners(self, term: str) -> tuple[float, float, float, float]:
        """Left foot, plateau and right foot of a term; a shoulder's outer corners are the universe's end."""
        left, top_left, top_right, right = self.shapes[self.terms.index(term)].corners
        if math.isinf(left):
            left = top_left = min(self.low, top_right)
        if math.isinf(right):
            top_right = right = max(self.high, top_left)
        return left, top_left, top_right, right

    def clip(self, value: float) -> float:
        """The value, or the end of the universe that it lies beyond."""
        return min(max(value, self.low), self.high)

    def grades(self, value: float) -> tuple[float, ...]:
        """Grade of every term at a value, clipped to the universe."""
        return tuple(shape.grade(self.clip(value)) for shape in self.shapes)

    def _check_universe(self) -> None:
        if len(self.universe) != 2 or not all(map(math.isfinite, self.universe)) or self.low >= self.high:
            raise RuleBaseError(
                f"variable {self.name}: universe {self.universe} must be two finite, ascending values"
            )

    def _check_peaks(self) -> None:
        for term, peak in zip(self.terms, self.peaks, strict=True):
            if not math.isfinite(peak):
                raise RuleBaseError(f"variable {self.name}, term {term}: peak {peak} must be finite")
        for k in range(1, len(self.peaks)):
            if self.peaks[k] <= self.peaks[k - 1]:
                raise RuleBaseError(
                    f"variable {self.name}, term {self.terms[k]}: peak {self.peaks[k]:g} must be greater "
                    f"than {self.peaks[k - 1]:g}, the peak of {self.terms[k - 1]}"
                )

    def _check_shapes(self) -> None:
        if len(self.shapes) != len(self.terms):
            raise RuleBaseError(
                f"variable {self.name}: {len(self.shapes)} membership functions for {len(self.terms)} terms"
            )
        for term, peak, shape in zip(self.terms, self.peaks, self.shapes, strict=True):
            if not shape.top_left <= peak <= shape.top_right:
                raise RuleBaseError(
                    f"variable {self.name}, term {term}: peak {peak:g} lies outside the plateau "
                    f"{shape.top_left:g} to {shape.top_right:g}"
                )
            if not self.low <= peak <= self.high:
                raise RuleBaseError(
                    f"variable {self.name}, term {term}: peak {peak:g} lies outside the universe "
                    f"{self.low:g} to {self.high:g}"
                )
        for k in range(1, len(self.shapes)):
            before, here = self.shapes[k - 1].corners, self.shapes[k].corners
            if any(b > h for b, h in zip(before, here, strict=True)):
                raise RuleBaseError(
                    f"variable {self.name}, term {self.terms[k]}: its membership function must not begin, "
                    f"level or end before that of {self.terms[k - 1]}"
                )
