"""One evaluation of a rule base: compiled, beside scikit-fuzzy's control system and simpful, in turns."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from benchmarks.rows import Row
from controller.fuzzy.bases import fsmc_rules, fuzzy_d_rules, fuzzy_pid_rules
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.oracle import skfuzzy_system
from controller.fuzzy.rulebase import ContinuousCentroid, RuleBase

POINTS = 40
OURS_PER_PEER = 100

Evaluation = Callable[[float, float], float]


def measure() -> list[Row]:
    rules = fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))
    continuous = replace(rules, defuzzification=ContinuousCentroid())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # scikit-fuzzy 0.5 with numpy 2
        return [
            _row("Fuzzy-D, discrete centroid", rules, "simpful, 101 points", by_simpful(rules), 1e-9),
            _row(
                "Fuzzy-D, continuous centroid",
                continuous,
                "scikit-fuzzy control, 101 points",
                by_scikit_fuzzy(continuous, 101),
                1e-2,
            ),
            _row(
                "Fuzzy-D, continuous centroid",
                continuous,
                "scikit-fuzzy control, 1001 points",
                by_scikit_fuzzy(continuous, 1001),
                1e-5,
            ),
            _row("fuzzy sliding mode, centre average", fsmc_rules(), "its kernel, no Python", None, 0.0),
            _row(
                "fuzzy PID, one of its three gains", fuzzy_pid_rules().kp, "its kernel, no Python", None, 0.0
            ),
        ]


def by_scikit_fuzzy(rules: RuleBase, points: int) -> Evaluation:
    from skfuzzy import control

    # Without its cache, which would only look up inputs seen before; a control loop has new ones.
    running = control.ControlSystemSimulation(skfuzzy_system(rules, points), cache=False)

    def evaluate(error: float, rate: float) -> float:
        running.input[rules.error.name], running.input[rules.rate.name] = error, rate
        running.compute()
        return float(running.output[rules.output.name])

    return evaluate


def by_simpful(rules: RuleBase) -> Evaluation:
    """The same declaration in simpful, whose Mamdani inference is a discrete centroid too."""
    import simpful

    system = simpful.FuzzySystem(show_banner=False)
    for variable in (rules.error, rules.rate, rules.output):
        shapes = [simpful.TrapezoidFuzzySet(*variable.corners(t), term=t) for t in variable.terms]
        made = simpful.LinguisticVariable(shapes, universe_of_discourse=[variable.low, variable.high])
        system.add_linguistic_variable(variable.name, made)
    error, rate, output = rules.error.name, rules.rate.name, rules.output.name
    system.add_rules(
        [
            f"IF ({error} IS {e}) AND ({rate} IS {r}) THEN ({output} IS {rules.rules[i][j]})"
            for j, e in enumerate(rules.error.terms)
            for i, r in enumerate(rules.rate.terms)
        ]
    )

    def evaluate(error_value: float, rate_value: float) -> float:
        system.set_variable(error, error_value)
        system.set_variable(rate, rate_value)
        return float(system.Mamdani_inference([output], subdivisions=101)[output])

    return evaluate


def _row(what: str, rules: RuleBase, peer_is: str, peer: Evaluation | None, tolerance: float) -> Row:
    compiled = CompiledRuleBase(rules)
    random = np.random.default_rng(1)
    errors = random.uniform(rules.error.low, rules.error.high, POINTS).tolist()
    rates = random.uniform(rules.rate.low, rules.rate.high, POINTS).tolist()
    inputs: list[tuple[float, float]] = list(zip(errors, rates, strict=True))
    if peer is None:
        return _beside_kernel(what, compiled, inputs, peer_is)
    span = rules.output.high - rules.output.low
    apart = max(abs(compiled(*pair) - peer(*pair)) for pair in inputs)
    if apart > tolerance * span:
        raise RuntimeError(
            f"{what}: {peer_is} computes something else, {apart / span:.1e} of the range apart"
        )
    ours: list[float] = []
    theirs: list[float] = []
    for pair in inputs:
        ours.append(_each_us(compiled, pair, OURS_PER_PEER))
        theirs.append(_each_us(peer, pair, 1))
    return Row(what, median(ours), median(theirs), "us", peer_is)


def _beside_kernel(
    what: str, compiled: CompiledRuleBase, inputs: list[tuple[float, float]], peer_is: str
) -> Row:
    errors, rates = (np.repeat(values, 1000) for values in np.array(inputs).T)
    compiled.array(errors, rates)
    ours = [_each_us(compiled, pair, OURS_PER_PEER) for pair in inputs]
    start = time.perf_counter_ns()
    compiled.array(errors, rates)
    kernel = (time.perf_counter_ns() - start) / errors.size / 1000
    return Row(what, median(ours), kernel, "us", peer_is)


def _each_us(evaluate: Callable[..., Any], pair: tuple[float, float], calls: int) -> float:
    error, rate = pair
    start = time.perf_counter_ns()
    for _ in range(calls):
        evaluate(error, rate)
    return (time.perf_counter_ns() - start) / calls / 1000
