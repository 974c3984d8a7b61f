"""The proof that a rule base has no hole: every input fires a rule, shown from the corners alone.

Corners of the membership functions and the crossings of their flanks cut a universe into pieces, on each of
which every grade is linear and one term is the greatest. On a rectangle of one piece of either input the
strengths of all rules are bounded from below by their values at its corners: some rule fires everywhere on
it if and only if one rule's two terms stay positive up to both ends of their pieces. (Two rules that vanish
at opposite ends of a piece would cross inside it; if each rule vanishes at some side, all vanish in one
corner.) No sampling, and a grade that merely tends to zero next to a jump counts as a hole.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

from controller.fuzzy.membership import Trapezoid
from controller.fuzzy.variable import Variable

LEAST_GRADE = 1e-9
"""What counts as positive: far above underflow, also when two grades are multiplied."""

SAME_POINT = 1e-12
"""Cuts closer than this share of the universe are one: rounding of crossings, not features."""


class Piece(NamedTuple):
    """A part of a universe without a corner or crossing inside; `terms` stay positive all over it."""

    start: float
    end: float
    terms: frozenset[int]
    positive_at_start: bool
    positive_at_end: bool


def pieces(variable: Variable) -> list[Piece]:
    """The pieces of a variable's universe, ascending."""
    shapes, low, high = variable.shapes, variable.low, variable.high
    corners = {min(max(x, low), high) for shape in shapes for x in shape.corners}
    cuts = _distinct({low, high, *corners})
    crossings = {x for a, b in pairwise(cuts) for x in _crossings(shapes, a, b)}
    cuts = _distinct({*cuts, *crossings})
    found = []
    for start, end in pairwise(cuts):
        limits = [shape.limits(start, end) for shape in shapes]
        terms = frozenset(k for k, both in enumerate(limits) if min(both) > LEAST_GRADE)
        at_start, at_end = (max(each) > LEAST_GRADE for each in zip(*limits, strict=True))
        found.append(Piece(start, end, terms, at_start, at_end))
    return found


def uncovered(variable: Variable) -> tuple[float, float] | None:
    """Where no term of a variable is true, from and to (equal: a point); None where there is no hole."""
    parts = pieces(variable)
    empty = [p for p in parts if not p.positive_at_start and not p.positive_at_end]
    if empty:
        end = empty[0].end
        for part in empty[1:]:
            end = part.end if part.start == end else end
        return empty[0].start, end
    for part in parts:
        if not part.positive_at_start:
            return part.start, part.start
        if not part.positive_at_end:
            return part.end, part.end
    return None


def no_rule_fires(
    error: Variable, rate: Variable, consequents: Sequence[Sequence[int]]
) -> tuple[Piece, Piece] | None:
    """A piece of either input between which no rule fires everywhere; None if there is none.

    `consequents[rate term][error term]` is negative where the table has no rule. Both variables must have
    been found covered.
    """
    for rate_piece in pieces(rate):
        for error_piece in pieces(error):
            if not any(consequents[i][j] >= 0 for i in rate_piece.terms for j in error_piece.terms):
                return error_piece, rate_piece
    return None


def _crossings(shapes: Sequence[Trapezoid], start: float, end: float) -> set[float]:
    """Where two grades are equal strictly inside an interval without corners."""
    found = set()
    for one, other in combinations([shape.limits(start, end) for shape in shapes], 2):
        before, after = one[0] - other[0], one[1] - other[1]
        if before * after < 0.0:
            found.add(start + (end - start) * before / (before - after))
    return found


def _distinct(cuts: set[float]) -> list[float]:
    ordered = sorted(cuts)
    least = SAME_POINT * (ordered[-1] - ordered[0])
    kept = ordered[:1]
    for cut in ordered[1:-1]:
        if cut - kept[-1] > least and ordered[-1] - cut > least:
            kept.append(cut)
    return [*kept, ordered[-1]]
