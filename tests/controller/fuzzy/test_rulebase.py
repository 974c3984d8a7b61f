from __future__ import annotations

import re

import pytest

from controller.fuzzy.rulebase import (
    FIVE_TERMS,
    FUZZY_D_RULES,
    SEVEN_TERMS,
    RuleBase,
    RuleBaseError,
    Variable,
    fuzzy_d_rules,
    parse_rules,
)

# The table as the reference gives it: rows de = NB..PB, columns e = NB..PB, 0 = NB .. 6 = PB.
TAB = ((0, 0, 1, 3, 4), (0, 0, 2, 4, 5), (0, 1, 3, 5, 6), (1, 2, 4, 6, 6), (2, 3, 5, 6, 6))


def rules() -> RuleBase:
    return fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))


def test_rules_are_those_of_the_paper():
    assert rules().consequents == TAB


def test_rule_table_is_antisymmetric():
    for i in range(5):
        for j in range(5):
            assert rules().consequents[4 - i][4 - j] == 6 - rules().consequents[i][j]


def test_triangles_reach_zero_at_the_neighbours_peaks():
    variable = Variable.symmetric("e", "m/s", FIVE_TERMS, (0.5, 1.0))
    assert variable.triangle("NB") == (-1.0, -1.0, -0.5)
    assert variable.triangle("Z") == (-0.5, 0.0, 0.5)
    assert variable.triangle("PB") == (0.5, 1.0, 1.0)


def test_universe_has_the_given_number_of_points_and_both_ends():
    universe = rules().universe()
    assert len(universe) == 101
    assert universe[0] == -1.5
    assert universe[-1] == pytest.approx(1.5, abs=1e-12)


@pytest.mark.parametrize(
    ("peaks", "message"),
    [
        ((0.0, 1.0), "term Z: peak 0 must be greater than -0, the peak of NS"),
        ((1.0, 0.5), "term NS: peak -1 must be greater than -0.5, the peak of NB"),
        ((0.5, float("nan")), "must be finite"),
        ((0.5, float("inf")), "must be finite"),
    ],
)
def test_peaks_that_do_not_ascend_or_are_not_finite_are_rejected(peaks, message):
    with pytest.raises(RuleBaseError, match=message) as error:
        Variable.symmetric("error", "m/s", FIVE_TERMS, peaks)
    assert error.value.exit_code == 2
    assert "\n" not in str(error.value)


def test_a_term_without_a_peak_is_rejected():
    with pytest.raises(RuleBaseError, match="5 terms but 2 peaks"):
        Variable("error", "m/s", FIVE_TERMS, (0.0, 1.0))


def test_a_term_named_twice_is_rejected():
    with pytest.raises(RuleBaseError, match="named twice"):
        Variable("error", "m/s", ("N", "N"), (0.0, 1.0))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (FUZZY_D_RULES.replace("NB   NS   Z    PS   PB\n", "NS   NB   Z    PS   PB\n", 1), "head line"),
        (re.sub(r"\n +PB \|.*", "", FUZZY_D_RULES), "rows are NB NS Z PS, must be"),
        ("", "head line"),
    ],
)
def test_an_incomplete_printed_table_is_rejected(table, message):
    with pytest.raises(RuleBaseError, match=message):
        parse_rules(table, columns=FIVE_TERMS, rows=FIVE_TERMS)


def with_rules(rows: tuple[tuple[str, ...], ...], points: int = 101, s: float = 0.5) -> RuleBase:
    return RuleBase(
        error=Variable.symmetric("error", "m/s", FIVE_TERMS, (0.5, 1.0)),
        rate=Variable.symmetric("rate", "m/s2", FIVE_TERMS, (1.0, 2.0)),
        output=Variable.symmetric("output", "m/s2", SEVEN_TERMS, (s, 1.0, 1.5)),
        rules=rows,
        points=points,
    )


def test_a_hole_in_the_rules_is_rejected():
    full = rules().rules
    with pytest.raises(RuleBaseError, match="4 rows for the 5 terms of rate"):
        with_rules(full[:-1])
    with pytest.raises(RuleBaseError, match="row NB: 4 cells for the 5 terms of error"):
        with_rules((full[0][:-1], *full[1:]))
    with pytest.raises(RuleBaseError, match="XX is no term of output"):
        with_rules((("XX", *full[0][1:]), *full[1:]))


def test_an_output_term_that_no_point_falls_under_is_rejected():
    # An empty aggregate would have no centroid; here the points straddle the narrow triangle of S.
    with pytest.raises(RuleBaseError, match="none of 3 falls under term NM"):
        with_rules(rules().rules, points=3)
    with pytest.raises(RuleBaseError, match="2 must be at least 3"):
        with_rules(rules().rules, points=2)
