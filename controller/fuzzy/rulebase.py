"""A fuzzy rule base, declared once and readably: two inputs, one output, rules, conjunction, defuzzification.

Mamdani: implication = min, aggregation = max. A rule base that loads is proven: every input fires a rule
(see :mod:`controller.fuzzy.coverage`), all numbers are finite and in order, and every term is used or the
declaration says that it is not. The rule bases of the control laws are in :mod:`controller.fuzzy.bases`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from controller.fuzzy.coverage import no_rule_fires, uncovered
from controller.fuzzy.membership import (
    RuleBaseError,
    Trapezoid,
    left_shoulder,
    right_shoulder,
    triangle,
)
from controller.fuzzy.variable import FIVE_TERMS, SEVEN_TERMS, Variable

__all__ = [
    "FIVE_TERMS",
    "NO_RULE",
    "SEVEN_TERMS",
    "CentreAverage",
    "Conjunction",
    "ContinuousCentroid",
    "Defuzzification",
    "DiscreteCentroid",
    "RuleBase",
    "RuleBaseError",
    "Trapezoid",
    "Variable",
    "left_shoulder",
    "parse_rules",
    "right_shoulder",
    "triangle",
]

NO_RULE = "-"
"""The cell of a rule table that has no rule."""

Conjunction = Literal["min", "product"]


@dataclass(frozen=True)
class DiscreteCentroid:
    """Sum of z m(z) over sum of m(z), over equally spaced points of the output universe (MATLAB: 101)."""

    points: int = 101


@dataclass(frozen=True)
class ContinuousCentroid:
    """Integral of z m(z) over integral of m(z), over the output universe, exact."""


@dataclass(frozen=True)
class CentreAverage:
    """Sum of strength times peak over sum of strengths: every rule counts by itself, shapes do not matter.

    Also called height defuzzification. With product and a partition it is bilinear interpolation.
    """


Defuzzification = DiscreteCentroid | ContinuousCentroid | CentreAverage


@dataclass(frozen=True)
class RuleBase:
    """`rules[rate term][error term]` names the output term, or is `NO_RULE`.

    `unused` names terms that no rule uses (as "output.PM"); a term that is in no rule and not named there is
    an error, and so is one that is named but used. RuleBaseError says which variable, term and value.
    """

    error: Variable
    rate: Variable
    output: Variable
    rules: tuple[tuple[str, ...], ...]
    conjunction: Conjunction = "min"
    defuzzification: Defuzzification = DiscreteCentroid()
    unused: tuple[str, ...] = ()
    consequents: tuple[tuple[int, ...], ...] = field(init=False)
    """As `rules`, by index of the output term; -1 is no rule."""

    def __post_init__(self) -> None:
        if self.conjunction not in ("min", "product"):
            raise RuleBaseError(f"conjunction: {self.conjunction!r} must be 'min' or 'product'")
        self._check_table()
        index = {term: k for k, term in enumerate(self.output.terms)} | {NO_RULE: -1}
        object.__setattr__(self, "consequents", tuple(tuple(index[c] for c in row) for row in self.rules))
        self._check_use()
        self._check_coverage()
        if isinstance(self.defuzzification, DiscreteCentroid):
            self._check_points(self.defuzzification.points)
        elif isinstance(self.defuzzification, ContinuousCentroid):
            self._check_areas()

    def sample(self) -> tuple[float, ...]:
        """The points of the discrete centroid, equally spaced over the output universe; else none."""
        if not isinstance(self.defuzzification, DiscreteCentroid):
            return ()
        low, high = self.output.low, self.output.high
        step = (high - low) / (self.defuzzification.points - 1)
        # The last sum may round to beyond the universe, where an upright edge has ended.
        return tuple(min(low + n * step, high) for n in range(self.defuzzification.points))

    def _check_table(self) -> None:
        if len(self.rules) != len(self.rate.terms):
            raise RuleBaseError(
                f"rules: {len(self.rules)} rows for the {len(self.rate.terms)} terms of {self.rate.name}"
            )
        for term, row in zip(self.rate.terms, self.rules, strict=True):
            if len(row) != len(self.error.terms):
                raise RuleBaseError(
                    f"rules, row {term}: {len(row)} cells for the {len(self.error.terms)} terms "
                    f"of {self.error.name}"
                )
            for cell in row:
                if cell != NO_RULE and cell not in self.output.terms:
                    raise RuleBaseError(f"rules, row {term}: {cell} is no term of {self.output.name}")

    def _check_use(self) -> None:
        used = {f"{self.output.name}.{cell}" for row in self.rules for cell in row}
        for i, row in enumerate(self.consequents):
            for j, cell in enumerate(row):
                if cell >= 0:
                    used |= {
                        f"{self.rate.name}.{self.rate.terms[i]}",
                        f"{self.error.name}.{self.error.terms[j]}",
                    }
        declared = {f"{v.name}.{term}" for v in (self.error, self.rate, self.output) for term in v.terms}
        for term in self.unused:
            if term not in declared - used:
                raise RuleBaseError(f"unused: {term} is used by a rule, or is no term")
        forgotten = sorted(declared - used - set(self.unused))
        if forgotten:
            raise RuleBaseError(
                f"rules: none uses {', '.join(forgotten)}; use it in a rule, or name it in `unused`"
            )

    def _check_coverage(self) -> None:
        for variable in (self.error, self.rate):
            hole = uncovered(variable)
            if hole:
                where = f"at {hole[0]:g}" if hole[0] == hole[1] else f"between {hole[0]:g} and {hole[1]:g}"
                raise RuleBaseError(
                    f"variable {variable.name}: no term covers it {where} {variable.unit}; "
                    "let membership functions overlap there"
                )
        gap = no_rule_fires(self.error, self.rate, self.consequents)
        if gap:
            error, rate = gap
            raise RuleBaseError(
                f"rules: none fires for {self.error.name} between {error.start:g} and {error.end:g} "
                f"{self.error.unit} with {self.rate.name} between {rate.start:g} and {rate.end:g} "
                f"{self.rate.unit}; add one"
            )

    def _check_points(self, points: int) -> None:
        if points < 3:
            raise RuleBaseError(f"points: {points} must be at least 3")
        for k in self._concluded():
            if not any(self.output.shapes[k].grade(z) > 0.0 for z in self.sample()):
                raise RuleBaseError(
                    f"points: none of {points} falls under term {self.output.terms[k]} of "
                    f"{self.output.name}; take more"
                )

    def _check_areas(self) -> None:
        low, high = self.output.universe
        for k in self._concluded():
            left, _, _, right = self.output.shapes[k].corners
            if not max(left, low) < min(right, high):
                raise RuleBaseError(
                    f"variable {self.output.name}, term {self.output.terms[k]}: no area between {low:g} and "
                    f"{high:g}, so its centroid is undefined; widen it or the universe"
                )

    def _concluded(self) -> list[int]:
        """Output terms that some rule concludes."""
        return sorted({cell for row in self.consequents for cell in row if cell >= 0})


def parse_rules(table: str, *, columns: Sequence[str], rows: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """Read a rule table as it is printed: a head line of column terms, then `row term | cells`.

    Every pair of terms must have a cell; heads may not be missing, repeated or in another order.
    """
    lines = [line.strip() for line in table.strip().splitlines() if line.strip()]
    parts = [line.split("|") for line in lines if "|" in line]
    if not parts or tuple(parts[0][-1].split()) != tuple(columns):
        raise RuleBaseError(f"rules: the head line must read {' '.join(columns)}")
    heads = tuple(head.strip() for head, _ in parts[1:])
    if heads != tuple(rows):
        raise RuleBaseError(f"rules: rows are {' '.join(heads)}, must be {' '.join(rows)}")
    return tuple(tuple(cells.split()) for _, cells in parts[1:])
