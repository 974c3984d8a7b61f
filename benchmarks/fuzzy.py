"""The Fuzzy-D rule base: compiled form beside scikit-fuzzy's control system."""

from __future__ import annotations

import time
from statistics import median

import numpy as np

from benchmarks.rows import Row
from controller.fuzzy.compiled import CompiledRuleBase
from controller.fuzzy.rulebase import fuzzy_d_rules

CALLS = 40


def measure() -> list[Row]:
    from skfuzzy import control, trimf

    rules = fuzzy_d_rules((0.5, 1.0), (1.0, 2.0), (0.5, 1.0, 1.5))
    compiled = CompiledRuleBase(rules)
    variables = []
    for variable, kind in (
        (rules.error, control.Antecedent),
        (rules.rate, control.Antecedent),
        (rules.output, control.Consequent),
    ):
        universe = np.linspace(variable.peaks[0], variable.peaks[-1], 101)
        made = kind(universe, variable.name)
        for term in variable.terms:
            made[term] = trimf(universe, variable.triangle(term))
        variables.append(made)
    error, rate, output = variables
    system = control.ControlSystem(
        [
            control.Rule(error[e] & rate[r], output[rules.rules[j][i]])
            for i, e in enumerate(rules.error.terms)
            for j, r in enumerate(rules.rate.terms)
        ]
    )
    simulation = control.ControlSystemSimulation(system, cache=False)
    inputs = np.random.default_rng(1).uniform(-1.0, 1.0, (CALLS, 2))
    compiled(0.1, 0.1)
    ours, peer = [], []
    for e, r in inputs:
        start = time.perf_counter_ns()
        for _ in range(100):
            compiled(e, r)
        ours.append((time.perf_counter_ns() - start) / 100_000)
        start = time.perf_counter_ns()
        simulation.input[rules.error.name], simulation.input[rules.rate.name] = e, r
        simulation.compute()
        peer.append((time.perf_counter_ns() - start) / 1000)
    return [
        Row("Fuzzy-D, one evaluation", median(ours), median(peer), "us", "scikit-fuzzy control, 101 points")
    ]
