"""A fuzzy rule base, declared once and readably: terms, membership functions, rules.

Two inputs, one output, Mamdani: and = min, implication = min, aggregation = max, defuzzification by
the discrete centroid over equally spaced points of the output universe. Terms are triangles that reach
zero at their neighbours' peaks; the first and the last term are shoulders, which is the same as
clipping the input to the universe. The memberships of any input therefore sum to one and some rule
always fires: a rule base that loads has no hole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

FIVE_TERMS = ("NB", "NS", "Z", "PS", "PB")
SEVEN_TERMS = ("NB", "NM", "NS", "Z", "PS", "PM", "PB")

FUZZY_D_RULES = """
          |  NB   NS   Z    PS   PB
      ----+------------------------
       NB |  NB   NB   NM   Z    PS
       NS |  NB   NB   NS   PS   PM
       Z  |  NB   NM   Z    PM   PB
       PS |  NM   NS   PS   PB   PB
       PB |  NS   Z    PM   PB   PB
"""
"""Rules of the SpeedT and Fuzzy-D controllers (Tables 1 and 2 of the Fuzzy-D paper, which are identical).

Columns: speed error (reference minus measured). Rows: its rate of change. Cells: control.
"""


class RuleBaseError(ValueError):
    """A rule base is not complete or not well formed: names variable, term and value."""

    exit_code = 2


@dataclass(frozen=True)
class Variable:
    """A linguistic variable: its terms and their peaks, ascending, in `unit`."""

    name: str
    unit: str
    terms: tuple[str, ...]
    peaks: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.terms) != len(self.peaks) or len(self.terms) < 2:
            raise RuleBaseError(
                f"variable {self.name}: {len(self.terms)} terms but {len(self.peaks)} peaks; "
                "give one peak for each of at least two terms"
            )
        if len(set(self.terms)) != len(self.terms):
            raise RuleBaseError(f"variable {self.name}: a term is named twice in {', '.join(self.terms)}")
        for term, peak in zip(self.terms, self.peaks, strict=True):
            if not math.isfinite(peak):
                raise RuleBaseError(f"variable {self.name}, term {term}: peak {peak} must be finite")
        for k in range(1, len(self.peaks)):
            if self.peaks[k] <= self.peaks[k - 1]:
                raise RuleBaseError(
                    f"variable {self.name}, term {self.terms[k]}: peak {self.peaks[k]:g} must be greater "
                    f"than {self.peaks[k - 1]:g}, the peak of {self.terms[k - 1]}"
                )

    @classmethod
    def symmetric(cls, name: str, unit: str, terms: Sequence[str], positive: Sequence[float]) -> Variable:
        """A variable symmetric about zero, given the peaks of its positive terms, ascending."""
        peaks = (*(-p for p in reversed(positive)), 0.0, *positive)
        return cls(name, unit, tuple(terms), peaks)

    def triangle(self, term: str) -> tuple[float, float, float]:
        """Left foot, peak and right foot of a term; a half triangle at either end of the universe."""
        k = self.terms.index(term)
        last = len(self.peaks) - 1
        return self.peaks[max(k - 1, 0)], self.peaks[k], self.peaks[min(k + 1, last)]


@dataclass(frozen=True)
class RuleBase:
    """`rules[rate term][error term]` names the output term; `points` is that of the discrete centroid."""

    error: Variable
    rate: Variable
    output: Variable
    rules: tuple[tuple[str, ...], ...]
    points: int = 101
    consequents: tuple[tuple[int, ...], ...] = field(init=False)

    def __post_init__(self) -> None:
        if self.points < 3:
            raise RuleBaseError(f"points: {self.points} must be at least 3")
        for term in self.output.terms:
            if not self._hit(*self.output.triangle(term)):
                raise RuleBaseError(
                    f"points: none of {self.points} falls under term {term} of {self.output.name}; take more"
                )
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
                if cell not in self.output.terms:
                    raise RuleBaseError(f"rules, row {term}: {cell} is no term of {self.output.name}")
        index = {term: k for k, term in enumerate(self.output.terms)}
        object.__setattr__(self, "consequents", tuple(tuple(index[c] for c in row) for row in self.rules))

    def universe(self) -> tuple[float, ...]:
        """The points of the discrete centroid, equally spaced from the first output peak to the last."""
        first, last = self.output.peaks[0], self.output.peaks[-1]
        step = (last - first) / (self.points - 1)
        return tuple(first + n * step for n in range(self.points))

    def _hit(self, left: float, peak: float, right: float) -> bool:
        """Whether a point of the universe has a grade above zero under this triangle."""
        at_end = peak in (left, right)
        return at_end or any(left < z < right for z in self.universe())


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


def fuzzy_d_rules(
    error_peaks: Sequence[float],
    rate_peaks: Sequence[float],
    output_peaks: Sequence[float],
    *,
    output_unit: str = "m/s^2",
) -> RuleBase:
    """Rule base of the Fuzzy-D paper over symmetric sets, given the positive peaks (2, 2 and 3 of them)."""
    return RuleBase(
        error=Variable.symmetric("error", "m/s", FIVE_TERMS, error_peaks),
        rate=Variable.symmetric("rate", "m/s^2", FIVE_TERMS, rate_peaks),
        output=Variable.symmetric("output", output_unit, SEVEN_TERMS, output_peaks),
        rules=parse_rules(FUZZY_D_RULES, columns=FIVE_TERMS, rows=FIVE_TERMS),
    )
