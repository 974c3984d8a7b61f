from __future__ import annotations

from dataclasses import fields
from itertools import product

import pytest

from controller.modes import DRIVING, TRANSITIONS, Conditions, Mode, next_mode

NAMES = [field.name for field in fields(Conditions)]

# (from, the conditions that hold, to): the machine as a reader expects it.
CASES = [
    (Mode.STANDBY, (), Mode.STANDBY),
    (Mode.STANDBY, ("inputs_valid",), Mode.STANDBY),
    (Mode.STANDBY, ("inputs_valid", "standstill"), Mode.READY),
    (Mode.STANDBY, ("inputs_valid", "standstill", "overridden"), Mode.STANDBY),
    (Mode.STANDBY, ("departure", "standstill"), Mode.STANDBY),
    (Mode.STANDBY, ("emergency", "inputs_valid", "standstill"), Mode.EMERGENCY),
    (Mode.READY, ("inputs_valid",), Mode.READY),
    (Mode.READY, (), Mode.STANDBY),
    (Mode.READY, ("inputs_valid", "overridden", "departure"), Mode.STANDBY),
    (Mode.READY, ("inputs_valid", "departure"), Mode.RUN),
    (Mode.READY, ("departure",), Mode.STANDBY),
    (Mode.READY, ("inputs_valid", "departure", "emergency"), Mode.EMERGENCY),
    (Mode.RUN, (), Mode.RUN),
    (Mode.RUN, ("inputs_valid", "departure"), Mode.RUN),
    (Mode.RUN, ("standstill",), Mode.RUN),
    (Mode.RUN, ("braking_to_stop",), Mode.STOPPING),
    (Mode.RUN, ("arrived", "standstill"), Mode.HOLD),
    (Mode.RUN, ("overridden", "braking_to_stop"), Mode.DEGRADED),
    (Mode.RUN, ("emergency", "overridden"), Mode.EMERGENCY),
    (Mode.STOPPING, (), Mode.STOPPING),
    (Mode.STOPPING, ("braking_to_stop",), Mode.STOPPING),
    (Mode.STOPPING, ("arrived",), Mode.HOLD),
    (Mode.STOPPING, ("overridden", "arrived"), Mode.DEGRADED),
    (Mode.STOPPING, ("emergency",), Mode.EMERGENCY),
    (Mode.HOLD, (), Mode.HOLD),
    (Mode.HOLD, ("inputs_valid", "departure", "standstill"), Mode.HOLD),
    (Mode.HOLD, ("overridden",), Mode.HOLD),
    (Mode.HOLD, ("emergency",), Mode.EMERGENCY),
    (Mode.DEGRADED, ("overridden",), Mode.DEGRADED),
    (Mode.DEGRADED, (), Mode.RUN),
    (Mode.DEGRADED, ("braking_to_stop",), Mode.STOPPING),
    (Mode.DEGRADED, ("braking_to_stop", "overridden"), Mode.DEGRADED),
    (Mode.DEGRADED, ("arrived", "overridden"), Mode.HOLD),
    (Mode.DEGRADED, ("emergency", "overridden"), Mode.EMERGENCY),
    (Mode.EMERGENCY, (), Mode.EMERGENCY),
    (Mode.EMERGENCY, ("standstill", "emergency"), Mode.EMERGENCY),
    (Mode.EMERGENCY, ("standstill",), Mode.STANDBY),
    (Mode.EMERGENCY, ("departure", "inputs_valid"), Mode.EMERGENCY),
]


@pytest.mark.parametrize(("mode", "holding", "then"), CASES)
def test_transition(mode, holding, then):
    assert next_mode(mode, Conditions(**dict.fromkeys(holding, True))) is then


def test_every_mode_and_condition_leads_where_the_table_says():
    for mode, values in product(Mode, product((False, True), repeat=len(NAMES))):
        holds = dict(zip(NAMES, values, strict=True))
        expected = mode
        for transition in TRANSITIONS:
            wanted = transition.mode is mode
            wanted = wanted and all(holds[name] for name in transition.when)
            if wanted and not any(holds[name] for name in transition.unless):
                expected = transition.then
                break
        assert next_mode(mode, Conditions(**holds)) is expected


def test_an_emergency_leads_to_emergency_from_every_mode():
    for mode, values in product(Mode, product((False, True), repeat=len(NAMES))):
        holds = dict(zip(NAMES, values, strict=True)) | {"emergency": True}
        assert next_mode(mode, Conditions(**holds)) is Mode.EMERGENCY


def test_the_train_is_driven_only_after_a_departure():
    for mode, values in product(Mode, product((False, True), repeat=len(NAMES))):
        holds = dict(zip(NAMES, values, strict=True))
        if next_mode(mode, Conditions(**holds)) in DRIVING and mode not in DRIVING:
            assert mode is Mode.READY
            assert holds["departure"]
            assert holds["inputs_valid"]
            assert not holds["overridden"]


def test_an_override_never_leaves_the_law_in_charge():
    for mode, values in product(Mode, product((False, True), repeat=len(NAMES))):
        holds = dict(zip(NAMES, values, strict=True)) | {"overridden": True}
        assert next_mode(mode, Conditions(**holds)) not in (Mode.RUN, Mode.STOPPING)


def test_every_condition_is_used_and_exists():
    used = {name for transition in TRANSITIONS for name in (*transition.when, *transition.unless)}
    assert used == set(NAMES)


def test_numbers_are_those_of_the_bus_contract(contract):
    signals = {signal.name: signal for signal in contract.message("ATO_Command").signals}
    assert {mode.value: mode.name for mode in Mode} == dict(signals["Mode"].choices)
