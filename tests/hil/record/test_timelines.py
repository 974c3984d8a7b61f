"""Places in time: lockstep ticks out of the stream, and quantities held until the next value."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.contract import ContractError
from hil.canbus.frame import Frame
from hil.record.blocks import decode_block
from hil.record.timelines import ForwardFill, LockstepTime, find_signal

TICK_NS = 10_000_000
START_NS = 1_000_000_000_000


def block(contract, *sent):
    frames = [
        Frame(7, contract.message(name).can_id, bytes(contract.message(name).encode(values)))
        for name, values in sent
    ]
    return decode_block(frames, contract)


def test_a_frame_belongs_to_the_tick_of_the_last_sync_before_it(contract):
    time = LockstepTime(contract, START_NS, TICK_NS)
    sent = [
        ("ATO_Status", {}),
        ("SYNC", {"Tick": 0}),
        ("ATO_Status", {}),
        ("SYNC", {"Tick": 1}),
        ("TCU_Status", {}),
    ]
    ticks = (time.of_frames(block(contract, *sent)) - START_NS) // TICK_NS
    assert ticks.tolist() == [0, 0, 0, 1, 1]


def test_the_tick_is_remembered_from_block_to_block(contract):
    time = LockstepTime(contract, START_NS, TICK_NS)
    time.of_frames(block(contract, ("SYNC", {"Tick": 41}), ("SYNC", {"Tick": 42})))
    times = time.of_frames(block(contract, ("TCU_Status", {}), ("SYNC", {"Tick": 43}), ("TCU_Status", {})))
    assert time.cycles(times).tolist() == [42, 43, 43]


def test_a_tick_that_is_no_time_is_refused(contract):
    with pytest.raises(ContractError, match="tick"):
        LockstepTime(contract, START_NS, 0)


@given(
    st.lists(st.tuples(st.integers(0, 50), st.integers(-9, 9)), min_size=1, max_size=30),
    st.lists(st.integers(-5, 60), max_size=20),
)
def test_forward_fill_gives_the_latest_value_known(known, asked):
    known = sorted(known, key=lambda pair: pair[0])
    fill = ForwardFill()
    half = len(known) // 2
    for part in (known[:half], known[half:]):
        times, values = (np.array([pair[k] for pair in part], np.int64) for k in (0, 1))
        fill.add(times, values)
    for time in asked:
        before = [value for at, value in known if at <= time]
        expected = before[-1] if before else known[0][1]
        assert fill.at(np.array([time], np.int64)).tolist() == [expected]


def test_forward_fill_forgets_the_distant_past_only():
    fill = ForwardFill(keep=100)
    for begin in range(0, 10_000, 50):
        fill.add(np.arange(begin, begin + 50), np.arange(begin, begin + 50) * 2)
    assert fill.at(np.array([9_950, 9_999, 20_000])).tolist() == [19_900, 19_998, 19_998]
    assert len(fill._times) == 100


def test_a_signal_that_is_not_in_the_contract_is_named(contract):
    assert find_signal("ODO_Motion.Position", contract).si_factor == pytest.approx(1e-3)
    for name in ("ODO_Motion.Nothing", "Nothing.Position"):
        with pytest.raises(ContractError, match="Nothing"):
            find_signal(name, contract)
