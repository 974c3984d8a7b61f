"""The phase of the grid: deadlines keep away from the kernel's tick wherever the period lets them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.node.phase import PHASE_NS, phase_off_the_tick
from hil.node.unit import default_phase_ns

MS = 1_000_000


def too_near(deadline_ns, tick_ns):
    offset = deadline_ns % tick_ns
    return offset < 50_000 or offset > tick_ns - 250_000


def hits(period_ns, phase_ns, tick_ns, deadlines=8000):
    return sum(too_near(k * period_ns + phase_ns, tick_ns) for k in range(deadlines)) / deadlines


@pytest.mark.parametrize(
    "period", [500_000, MS, 2 * MS, 3 * MS, 5 * MS, 7_500_000, 10 * MS, 20 * MS, 50 * MS]
)
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_no_deadline_of_an_ordinary_period_is_near_a_tick(period, share):
    phase = phase_off_the_tick(period, PHASE_NS + int(share * period))
    assert hits(period, phase, 4 * MS) == hits(period, phase, MS) == 0


@settings(deadline=None)
@given(st.integers(10, 10_000), st.integers(0, 10**8))
def test_phase_is_never_worse_than_the_one_wanted(ten_us, wanted):
    period = ten_us * 10_000  # 400 deadlines visit every place between two ticks
    phase = phase_off_the_tick(period, wanted)
    assert phase >= 0
    assert hits(period, phase, 4 * MS, 400) <= hits(period, wanted, 4 * MS, 400)


@given(st.integers(1, 100), st.integers(0, 3_000))
def test_good_phase_is_left_as_it_is(milliseconds, wanted_us):
    wanted = wanted_us * 1000
    if not too_near(wanted, MS):
        assert phase_off_the_tick(milliseconds * MS, wanted) == wanted


@pytest.mark.parametrize("period", [1_000_000, 5_000_000, 10_000_000])
def test_units_that_follow_one_another_are_half_a_period_apart_and_off_the_tick(fakes, period):
    first, second = fakes.Unit(period_ns=period), fakes.Unit(period_ns=period, after=("ATO_SyncDone",))
    distance = (default_phase_ns(second) - default_phase_ns(first)) % period
    assert abs(distance - period // 2) <= 250_000
    for unit in (first, second):
        assert hits(period, default_phase_ns(unit), MS) == 0


def test_period_of_nothing_is_refused():
    with pytest.raises(ValueError, match="greater than 0"):
        phase_off_the_tick(0, 5)
