from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.effort import EffortMap


@pytest.fixture(scope="module")
def journey(journeys):
    return journeys["fuzzy_d_2km"]


@pytest.fixture(scope="module")
def effort(journey):
    return EffortMap(journey.line, journey.train)


@given(position=st.floats(-50.0, 2300.0), speed=st.floats(0.0, 25.0))
def test_resistance_is_the_railways_own(effort, journey, position, speed):
    train, line = journey.train, journey.line
    specific = line.mean_specific_resistance(position, train.length_m)
    force = train.running_resistance_n(speed) + train.track_resistance_n(specific)
    expected = force / train.effective_mass_kg
    assert effort.resistance_mps2(position, speed) == pytest.approx(expected, abs=1e-12)


@given(demand=st.floats(-1.0, 1.0), speed=st.floats(0.1, 25.0), position=st.floats(0.0, 2000.0))
def test_demand_is_the_inverse_of_the_shared_definition(effort, journey, demand, speed, position):
    train = journey.train
    resistance = effort.resistance_mps2(position, speed)
    acceleration = train.effort_n(demand, speed) / train.effective_mass_kg - resistance
    assert effort.demand(acceleration, resistance, speed) == pytest.approx(demand, abs=1e-9)


@given(acceleration=st.floats(-100.0, 100.0), speed=st.floats(-1.0, 60.0))
def test_demand_is_limited_to_full_effort(effort, acceleration, speed):
    assert -1.0 <= effort.demand(acceleration, 0.0, speed) <= 1.0


@given(speed=st.floats(0.0, 25.0), position=st.floats(0.0, 2000.0))
def test_authority_is_where_the_demand_saturates(effort, speed, position):
    resistance = effort.resistance_mps2(position, speed)
    lowest, highest = effort.authority_mps2(speed, resistance)
    assert effort.demand(lowest, resistance, speed) == pytest.approx(-1.0, abs=1e-9)
    assert effort.demand(highest, resistance, speed) == pytest.approx(1.0, abs=1e-9)
    assert effort.demand(highest - 0.01, resistance, speed) < 1.0


def test_without_compensation_there_is_no_resistance(journey):
    assert EffortMap(journey.line, journey.train, resistance=False).resistance_mps2(300.0, 10.0) == 0.0
