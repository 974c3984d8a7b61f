from __future__ import annotations

import re

import pytest

from controller.fuzzy.bases import FUZZY_D_RULES, fuzzy_d_rules
from controller.fuzzy.rulebase import (
    FIVE_TERMS,
    NO_RULE,
    SEVEN_TERMS,
    CentreAverage,
    ContinuousCentroid,
    DiscreteCentroid,
    RuleBase,
    RuleBaseError,
    Variable,
    left_shoulder,
    parse_rules,
    right_shoulder,
    triangle,
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


def test_sample_has_the_given_number_of_points_and_both_ends():
    sample = rules().sample()
    assert len(sample) == 101
    assert sample[0] == -1.5
    assert sample[-1] == pytest.approx(1.5, abs=1e-12)


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


def with_rules(rows: tuple[tuple[str, ...], ...], s: float = 0.5, **declared) -> RuleBase:
    return RuleBase(
        error=Variable.symmetric("error", "m/s", FIVE_TERMS, (0.5, 1.0)),
        rate=Variable.symmetric("rate", "m/s2", FIVE_TERMS, (1.0, 2.0)),
        output=Variable.symmetric("output", "m/s2", SEVEN_TERMS, (s, 1.0, 1.5)),
        rules=rows,
        **declared,
    )


def changed(rows: tuple[tuple[str, ...], ...], cells: dict[tuple[int, int], str]):
    return tuple(tuple(cells.get((i, j), cell) for j, cell in enumerate(row)) for i, row in enumerate(rows))


def test_a_table_that_does_not_fit_its_variables_is_rejected():
    full = rules().rules
    with pytest.raises(RuleBaseError, match="4 rows for the 5 terms of rate"):
        with_rules(full[:-1])
    with pytest.raises(RuleBaseError, match="row NB: 4 cells for the 5 terms of error"):
        with_rules((full[0][:-1], *full[1:]))
    with pytest.raises(RuleBaseError, match="XX is no term of output"):
        with_rules((("XX", *full[0][1:]), *full[1:]))


def test_a_missing_rule_is_rejected_where_no_other_rule_fires():
    # At the peaks of both Z only the middle rule fires.
    rows = changed(rules().rules, {(2, 2): NO_RULE})
    with pytest.raises(
        RuleBaseError, match=r"none fires for error between -0.25 and 0 m/s with rate between -0.5 and 0 m/s2"
    ) as error:
        with_rules(rows)
    assert "\n" not in str(error.value)


def test_a_missing_rule_is_accepted_where_its_neighbours_fire():
    wide = Variable.shaped(
        "error",
        "m/s",
        (-1.0, 1.0),
        {"N": left_shoulder(-0.5, 0.5), "Z": triangle(-0.9, 0.0, 0.9), "P": right_shoulder(-0.5, 0.5)},
    )
    rate = Variable("rate", "m/s2", ("N", "P"), (-1.0, 1.0))
    output = Variable("output", "m/s2", ("N", "Z", "P"), (-1.0, 0.0, 1.0))
    # Around error 0 both N and P are at half height: the Z column may lack a rule.
    sparse = RuleBase(wide, rate, output, (("N", "-", "Z"), ("Z", "P", "P")))
    assert sparse.consequents == ((0, -1, 1), (1, 2, 2))


def test_an_output_term_that_no_rule_uses_must_be_declared_unused():
    rows = tuple(tuple("PS" if cell == "PM" else cell for cell in row) for row in rules().rules)
    with pytest.raises(RuleBaseError, match=r"none uses output.PM; use it in a rule, or name it in `unused`"):
        with_rules(rows)
    assert with_rules(rows, unused=("output.PM",)).unused == ("output.PM",)
    with pytest.raises(RuleBaseError, match=r"unused: output.PM is used by a rule"):
        with_rules(rules().rules, unused=("output.PM",))


def test_an_input_term_that_no_rule_reads_must_be_declared_unused():
    error = Variable.shaped(
        "error",
        "m/s",
        (-1.0, 1.0),
        {"N": left_shoulder(-0.5, 0.5), "Z": triangle(-0.9, 0.0, 0.9), "P": right_shoulder(-0.5, 0.5)},
    )
    rate = Variable("rate", "m/s2", ("N", "P"), (-1.0, 1.0))
    output = Variable("output", "m/s2", ("N", "P"), (-1.0, 1.0))
    table = (("N", "-", "N"), ("P", "-", "P"))
    with pytest.raises(RuleBaseError, match=r"none uses error.Z"):
        RuleBase(error, rate, output, table)
    assert RuleBase(error, rate, output, table, unused=("error.Z",)).consequents[0] == (0, -1, 0)


def test_an_output_term_that_no_point_falls_under_is_rejected():
    # An empty aggregate would have no centroid; here the points straddle the narrow triangle of S.
    with pytest.raises(RuleBaseError, match="none of 3 falls under term NM"):
        with_rules(rules().rules, defuzzification=DiscreteCentroid(3))
    with pytest.raises(RuleBaseError, match="2 must be at least 3"):
        with_rules(rules().rules, defuzzification=DiscreteCentroid(2))
    # The centroid that integrates needs no points.
    assert with_rules(rules().rules, defuzzification=ContinuousCentroid()).sample() == ()


def test_an_output_term_without_area_inside_the_universe_has_no_continuous_centroid():
    one = Variable("error", "m/s", ("N", "P"), (-1.0, 1.0))
    rate = Variable("rate", "m/s2", ("N", "P"), (-1.0, 1.0))
    outward = {"N": triangle(-1, -1, 0), "P": triangle(1, 1, 2)}
    output = Variable.shaped("output", "m/s2", (-1.0, 1.0), outward)
    table = (("N", "P"), ("P", "P"))
    with pytest.raises(RuleBaseError, match="variable output, term P: no area between -1 and 1"):
        RuleBase(one, rate, output, table, defuzzification=ContinuousCentroid())
    assert RuleBase(one, rate, output, table, defuzzification=CentreAverage()).consequents[0] == (0, 1)


def test_an_unknown_conjunction_is_rejected():
    with pytest.raises(RuleBaseError, match="'mean' must be 'min' or 'product'"):
        with_rules(rules().rules, conjunction="mean")
