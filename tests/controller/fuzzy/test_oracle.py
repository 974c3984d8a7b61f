from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import simpful
from skfuzzy import control, trimf

from controller.fuzzy.bases import fsmc_rules, fuzzy_d_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.membership import triangle
from controller.fuzzy.oracle import reference, skfuzzy_system, universe_with_corners
from controller.fuzzy.rulebase import ContinuousCentroid, DiscreteCentroid, RuleBase, RuleBaseError
from controller.fuzzy.variable import Variable

# Inside scikit-fuzzy 0.5, with numpy 2.
pytestmark = pytest.mark.filterwarnings("ignore:Passing more than 2 positional arguments:DeprecationWarning")

PAPER = fuzzy_d_rules((6.866, 13.731), (1.443, 20.507), (391.20, 399.57, 541.99), output_unit="1")
TRAIN = fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))
BASES = {
    "paper": PAPER,
    "train": TRAIN,
    "fsmc": fsmc_rules(),
    "product": replace(TRAIN, conjunction="product"),
}


@pytest.fixture(params=[*BASES, "odd"])
def continuous(request, odd_rules) -> RuleBase:
    return replace(BASES.get(request.param, odd_rules), defuzzification=ContinuousCentroid())


def simulation(rules: RuleBase, points: int = 1001, **options) -> control.ControlSystemSimulation:
    return control.ControlSystemSimulation(skfuzzy_system(rules, points), **options)


def computed(running: control.ControlSystemSimulation, rules: RuleBase, error: float, rate: float) -> float:
    running.input[rules.error.name], running.input[rules.rate.name] = error, rate
    running.compute()
    return float(running.output[rules.output.name])


def test_continuous_centroid_agrees_with_scikit_fuzzys_control_at_1001_points(continuous):
    running = simulation(continuous, cache=False)
    compiled = CompiledRuleBase(continuous)
    errors = np.linspace(continuous.error.low, continuous.error.high, 9)
    rates = np.linspace(continuous.rate.low, continuous.rate.high, 9)
    random = np.random.default_rng(3).uniform(
        (1.2 * continuous.error.low, 1.2 * continuous.rate.low),
        (1.2 * continuous.error.high, 1.2 * continuous.rate.high),
        (60, 2),
    )
    inputs = [*((e, r) for e in errors for r in rates), *random]
    worst = max(abs(compiled(e, r) - computed(running, continuous, e, r)) for e, r in inputs)
    assert worst <= 1e-5 * (continuous.output.high - continuous.output.low)


def test_scikit_fuzzy_approaches_the_continuous_centroid_as_its_points_grow():
    rules = replace(PAPER, defuzzification=ContinuousCentroid())
    compiled = CompiledRuleBase(rules)
    inputs = [(2.5, -1.0), (5.0, 1.0), (-9.0, 7.0), (1.0, -15.0)]
    away = []
    for points in (26, 101, 1601):
        running = simulation(rules, points, cache=False)
        away.append(max(abs(computed(running, rules, e, r) - compiled(e, r)) for e, r in inputs))
    # Second order: points times 4 and times 16. A chord may come out well by chance, hence the margin.
    assert away[1] < away[0] / 4
    assert away[2] < away[1] / 64


def test_scikit_fuzzys_centroid_is_no_oracle_for_the_discrete_one():
    apart = abs(
        reference(PAPER, 6.8655, -10.2535) - computed(simulation(PAPER, 101), PAPER, 6.8655, -10.2535)
    )
    assert apart > 1e-3 * PAPER.output.high


def test_discrete_centroid_equals_simpfuls_with_as_many_points():
    system = simpful.FuzzySystem(show_banner=False)
    for variable in (PAPER.error, PAPER.rate, PAPER.output):
        shapes = [simpful.TrapezoidFuzzySet(*variable.corners(term), term=term) for term in variable.terms]
        made = simpful.LinguisticVariable(shapes, universe_of_discourse=[variable.low, variable.high])
        system.add_linguistic_variable(variable.name, made)
    system.add_rules(
        [
            f"IF (error IS {e}) AND (rate IS {r}) THEN (output IS {PAPER.rules[i][j]})"
            for j, e in enumerate(PAPER.error.terms)
            for i, r in enumerate(PAPER.rate.terms)
        ]
    )
    compiled = CompiledRuleBase(PAPER)
    for error in np.linspace(-13.5, 13.5, 11):
        for rate in np.linspace(-20.0, 20.0, 9):
            system.set_variable("error", error)
            system.set_variable("rate", rate)
            by_simpful = system.Mamdani_inference(["output"], subdivisions=101)["output"]
            assert compiled(error, rate) == pytest.approx(by_simpful, abs=1e-9 * PAPER.output.high)


def test_many_points_bring_the_discrete_centroid_to_the_continuous_one():
    errors, rates = np.linspace(-13, 13, 21)[:, None], np.linspace(-20, 20, 17)
    exact = CompiledRuleBase(replace(PAPER, defuzzification=ContinuousCentroid())).array(errors, rates)
    away = [
        np.abs(CompiledRuleBase(replace(PAPER, defuzzification=way)).array(errors, rates) - exact).max()
        for way in (DiscreteCentroid(101), DiscreteCentroid(1001), DiscreteCentroid(10001))
    ]
    assert away[1] < away[0] / 5
    assert away[2] < away[1] / 5


def test_universe_of_the_oracle_holds_every_corner_and_the_given_number_of_points():
    universe = universe_with_corners(PAPER.output, 1001)
    assert len(universe) == 1001
    assert set(PAPER.output.peaks) <= set(universe)


def test_reference_refuses_a_non_finite_input():
    with pytest.raises(ValueError, match="not finite"):
        reference(TRAIN, math.nan, 0.0)


def test_two_variables_of_one_name_are_refused():
    one = Variable("x", "1", ("N", "P"), (-1.0, 1.0))
    rules = RuleBase(one, one, Variable("u", "1", ("N", "P"), (-1.0, 1.0)), (("N", "P"), ("P", "P")))
    with pytest.raises(RuleBaseError, match="three different variable names, not x, x, u"):
        skfuzzy_system(rules)


# What scikit-fuzzy does that a control loop must not, each beside what ours does.


def test_trap_a_lost_input_is_a_plausible_output_of_scikit_fuzzy_and_an_error_of_ours():
    running = simulation(TRAIN, 101)
    # fmin ignores NaN: each rule takes the other input's grade, and they balance out to zero.
    assert computed(running, TRAIN, math.nan, 0.5) == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(ValueError, match="not finite: error nan"):
        CompiledRuleBase(TRAIN)(math.nan, 0.5)
    # A lost rate does not even give zero.
    assert 0.5 < computed(running, TRAIN, 0.8, math.nan) < 0.7
    with pytest.raises(ValueError, match="not finite"):
        CompiledRuleBase(TRAIN)(0.8, math.nan)


def test_trap_an_uncovered_input_gives_scikit_fuzzys_previous_output_and_does_not_load_in_ours():
    universe = np.linspace(-1, 1, 201)
    error, output = control.Antecedent(universe, "error"), control.Consequent(universe, "output")
    for one in (error, output):
        one["N"], one["P"] = trimf(universe, [-1, -1, -0.2]), trimf(universe, [0.2, 1, 1])
    rules = [control.Rule(error[term], output[term]) for term in ("N", "P")]
    running = control.ControlSystemSimulation(control.ControlSystem(rules))
    outputs = []
    for value in (0.8, 0.0, -0.8, 0.0):
        running.input["error"] = value
        running.compute()
        outputs.append(running.output.get("output"))
    # Nothing fires at 0: no output the first time, and the second time whatever came before.
    assert outputs[1] is None
    assert outputs[3] == outputs[2] < -0.5

    with pytest.raises(RuleBaseError, match=r"no term covers it between -0.2 and 0.2"):
        _with_that_hole()


def _with_that_hole() -> RuleBase:
    shapes = {"N": triangle(-1, -1, -0.2), "P": triangle(0.2, 1, 1)}
    error, output = (Variable.shaped(name, "1", (-1.0, 1.0), shapes) for name in ("error", "output"))
    rate = Variable("rate", "1", ("N", "P"), (-1.0, 1.0))
    return RuleBase(error, rate, output, (("N", "P"), ("N", "P")))


def test_trap_scikit_fuzzy_forgets_its_inputs_after_1000_runs_and_ours_has_none():
    universe = np.linspace(-1, 1, 5)
    error, rate = control.Antecedent(universe, "error"), control.Antecedent(universe, "rate")
    output = control.Consequent(universe, "output")
    for one in (error, rate, output):
        one["N"], one["P"] = trimf(universe, [-1, -1, 1]), trimf(universe, [-1, 1, 1])
    rules = [control.Rule(error["N"] & rate["N"], output["N"]), control.Rule(error["P"], output["P"])]
    running = control.ControlSystemSimulation(control.ControlSystem(rules))
    running.input["rate"] = 0.25  # set once, as something that changes rarely would be
    errors = np.linspace(-1, 1, 1001)
    for value in errors[:1000]:
        running.input["error"] = value
        running.compute()
    running.input["error"] = errors[1000]
    with pytest.raises(ValueError, match="All antecedents must have input values"):
        running.compute()

    compiled, fresh = CompiledRuleBase(TRAIN), CompiledRuleBase(TRAIN)
    for value in errors:
        compiled(value, 0.25)
    assert compiled(0.3, 0.25) == fresh(0.3, 0.25)
