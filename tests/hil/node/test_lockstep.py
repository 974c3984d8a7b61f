"""Lockstep clock: order, waiting, decimation, and what it says of a lost peer."""

from __future__ import annotations

import pytest

from hil.canbus.contract import ContractError
from hil.canbus.frame import Frame
from hil.node import LockstepClock, LockstepError, Node

TICK = 10_000_000


@pytest.fixture
def frame(contract):
    def make(name, tick=None):
        codec = contract.message(name)
        return Frame(0, codec.can_id, bytes(codec.encode({} if tick is None else {"Tick": tick})))

    return make


@pytest.fixture
def ticks_sent(contract):
    def read(transport, name="ATO_SyncDone"):
        codec = contract.message(name)
        return [int(codec.decode(data)["Tick"]) for can_id, data in transport.log if can_id == codec.can_id]

    return read


def controller_clock(contract, transport, **options):
    return LockstepClock(transport, contract, "ATO", (), TICK, **options)


def plant_clock(contract, transport, **options):
    return LockstepClock(transport, contract, "TCU", ("ATO_SyncDone",), TICK, **options)


def test_sync_starts_the_cycle_and_is_acknowledged(contract, fakes, frame, ticks_sent):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport)
    for k in range(3):
        transport.waiting.append(frame("SYNC", k))
        start = clock.wait()
        assert (start.scheduled_ns, start.now_ns, start.skipped) == (k * TICK, k * TICK, 0)
        assert ticks_sent(transport) == list(range(k))
        assert clock.finished(0) == 0
    assert ticks_sent(transport) == [0, 1, 2]


def test_frames_before_the_completing_one_are_the_input_and_later_ones_wait(contract, fakes, frame):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport)
    transport.waiting.extend([frame("ODO_Motion"), frame("SYNC", 0), frame("TCU_Status"), frame("SYNC", 1)])
    clock.wait()
    assert [f.can_id for f in clock.frames()] == [0x184]
    clock.finished(0)
    clock.wait()
    assert [f.can_id for f in clock.frames()] == [0x182]


def test_plant_waits_for_the_controllers_answer_to_the_same_tick(contract, fakes, frame):
    transport = fakes.Transport()
    clock = plant_clock(contract, transport)
    arrivals = iter([frame("SYNC", 4), frame("ATO_Command"), frame("ATO_SyncDone", 4)])
    transport.on_wait = lambda: transport.waiting.append(next(arrivals))
    start = clock.wait()
    assert start.scheduled_ns == 4 * TICK
    assert transport.waits == 3
    [command] = clock.frames()
    assert (command.can_id, command.timestamp_ns) == (0x181, 4 * TICK)


def test_answer_to_an_earlier_tick_does_not_count(contract, fakes, frame):
    transport = fakes.Transport()
    clock = plant_clock(contract, transport, peer_timeout_s=1.0)
    transport.waiting.extend([frame("ATO_SyncDone", 3), frame("SYNC", 4)])
    with pytest.raises(LockstepError, match=r"ATO_SyncDone\(4\) did not come within 1 s after SYNC\(4\)"):
        clock.wait()


def test_answer_may_come_before_sync(contract, fakes, frame):
    transport = fakes.Transport()
    clock = plant_clock(contract, transport)
    transport.waiting.extend([frame("ATO_SyncDone", 0), frame("SYNC", 0)])
    assert clock.wait().scheduled_ns == 0


def test_answers_stand_for_a_sync_that_is_not_listened_to(contract, fakes, frame, ticks_sent):
    transport = fakes.Transport()
    clock = plant_clock(contract, transport)
    for k in range(3):
        transport.waiting.extend([frame("ATO_Command"), frame("ATO_SyncDone", k)])
        start = clock.wait()
        [command] = clock.frames()
        assert (start.scheduled_ns, command.timestamp_ns) == (k * TICK, k * TICK)
        clock.finished(0)
    assert ticks_sent(transport, "TCU_SyncDone") == [0, 1, 2]


def test_an_answer_to_a_tick_far_ahead_stands_for_no_sync(contract, fakes, frame):
    transport = fakes.Transport()
    clock = plant_clock(contract, transport, peer_timeout_s=1.0)
    transport.waiting.append(frame("ATO_SyncDone", 7))
    with pytest.raises(LockstepError, match="the first SYNC"):
        clock.wait()


def test_input_of_the_last_tick_is_one_tick_old(contract, fakes, frame):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport)
    transport.waiting.extend([frame("SYNC", 0)])
    clock.wait()
    clock.finished(0)
    transport.waiting.extend([frame("ODO_Motion"), frame("SYNC", 1)])
    start = clock.wait()
    assert start.now_ns - clock.frames()[0].timestamp_ns == TICK


def test_longer_period_steps_on_its_multiples_and_acknowledges_every_tick(contract, fakes, frame, ticks_sent):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport, period_ns=3 * TICK)
    starts, inputs = [], []
    for k in range(7):
        transport.waiting.extend([frame("ODO_Motion"), frame("SYNC", k)])
    while (start := clock.wait(lambda: not transport.waiting)) is not None:
        if not start.idle:
            starts.append(start.scheduled_ns)
            inputs.append(len(clock.frames()))
        clock.finished(0)
    assert starts == [0, 3 * TICK, 6 * TICK]
    assert inputs == [1, 3, 3]
    assert ticks_sent(transport) == list(range(7))


def test_period_that_is_no_multiple_of_the_tick_is_refused(contract, fakes):
    with pytest.raises(ValueError, match="whole multiple"):
        controller_clock(contract, fakes.Transport(), period_ns=TICK * 3 // 2)


def test_silent_bench_is_named(contract, fakes, frame):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport, peer_timeout_s=2.0)
    with pytest.raises(LockstepError, match="the first SYNC did not come within 2 s") as caught:
        clock.wait()
    assert caught.value.exit_code == 3
    transport.waiting.append(frame("SYNC", 0))
    clock.wait()
    clock.finished(0)
    with pytest.raises(LockstepError, match=r"SYNC\(1\) did not come"):
        clock.wait()


def test_silence_is_found_though_other_frames_go_by(contract, fakes, frame):
    time, transport = fakes.Time(step_ns=50_000_000), fakes.Transport()
    clock = controller_clock(contract, transport, peer_timeout_s=2.0, monotonic=time.monotonic)
    transport.on_wait = lambda: transport.waits % 2 and transport.waiting.append(frame("BENCH_Heartbeat"))
    with pytest.raises(LockstepError, match="the first SYNC"):
        clock.wait()


def test_time_in_which_this_process_was_stopped_is_not_held_against_the_peer(contract, fakes, frame):
    time, transport = fakes.Time(), fakes.Transport()
    clock = controller_clock(contract, transport, peer_timeout_s=60.0, monotonic=time.monotonic)

    def paused_for_an_hour():
        time.now_ns += 3600 * 10**9
        if transport.waits == 1:
            transport.waiting.append(frame("BENCH_Heartbeat"))
        elif transport.waits == 3:
            transport.waiting.append(frame("SYNC", 0))

    transport.on_wait = paused_for_an_hour
    assert clock.wait().scheduled_ns == 0


def test_lost_ticks_are_an_error(contract, fakes, frame):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport)
    transport.waiting.extend([frame("SYNC", 5), frame("SYNC", 7)])
    clock.wait()
    clock.finished(0)
    with pytest.raises(LockstepError, match=r"SYNC\(7\) followed SYNC\(5\)"):
        clock.wait()


def test_repeated_sync_does_not_step_twice(contract, fakes, frame, ticks_sent):
    transport = fakes.Transport()
    clock = controller_clock(contract, transport)
    transport.waiting.extend([frame("SYNC", 0), frame("SYNC", 0), frame("SYNC", 1)])
    assert clock.wait().scheduled_ns == 0
    clock.finished(0)
    assert clock.wait().scheduled_ns == TICK
    assert ticks_sent(transport) == [0]


def test_stop_request_ends_the_wait(contract, fakes):
    transport = fakes.Transport()
    assert controller_clock(contract, transport).wait(lambda: transport.waits >= 2) is None


def test_contract_without_the_nodes_acknowledgement_is_refused(contract, fakes):
    with pytest.raises(ContractError, match="ODO_SyncDone"):
        LockstepClock(fakes.Transport(), contract, "ODO", (), TICK)


def test_two_units_in_lockstep_step_in_turn_and_send_the_same_frames_every_time(contract, fakes, frame):
    """One thread, no waiting: the bench may run both units cycle by cycle."""

    def run():
        ato, tcu, bench = fakes.Transport(), fakes.Transport(), fakes.Transport()
        ato.peers, tcu.peers, bench.peers = [tcu, bench], [ato, bench], [ato, tcu]
        order = []
        controller = fakes.Unit(receives=("TCU_Status",), on_step=lambda: order.append("controller"))
        plant = fakes.Unit(
            nodes=("TCU", "ODO"), receives=("ATO_Command",), after=("ATO_SyncDone",),
            outputs={"TCU_Status": {"TractiveEffort": 1000.0}}, on_step=lambda: order.append("plant"),
        )  # fmt: skip
        nodes = [
            Node(controller, ato, controller_clock(contract, ato), None, contract),
            Node(plant, tcu, plant_clock(contract, tcu), None, contract),
        ]
        for k in range(30):
            bench.send(*frame("SYNC", k)[1:])
            assert all(node.cycle() for node in nodes)
        assert plant.steps[-1][0] == 29 * TICK
        assert [age for _, _, age in controller.steps[1:]] == [TICK] * 29
        assert [age for _, _, age in plant.steps] == [0] * 30
        assert plant.timing.wakeup_latency_ns == plant.timing.execution_ns == 0
        return order, list(bench.waiting)

    order, frames = run()
    assert order == ["controller", "plant"] * 30
    assert run() == (order, frames)
