"""A node's cycle: order of its steps, its timing, missed deadlines, a lost bus."""

from __future__ import annotations

import itertools

import pytest

from hil.canbus.errors import BusLost
from hil.canbus.frame import Frame
from hil.node import DeadlinesMissed, Node, OverloadPolicy, RealTimeClock, TimingReader, TimingRing

PERIOD = 10_000_000


@pytest.fixture
def bench(contract, fakes, tmp_path):
    """A node in real time on a fake clock: node, time, transport, unit, ring reader."""

    class Bench:
        def __init__(self, **options):
            self.time = fakes.Time()
            self.transport = fakes.Transport()
            self.unit = fakes.Unit()
            clock = RealTimeClock(
                PERIOD, 700_000, monotonic=self.time.monotonic, sleep_until=self.time.sleep_until,
                realtime=self.time.realtime, transport=self.transport,
            )  # fmt: skip
            ring = TimingRing(
                tmp_path / "ring", name="fake", period_ns=PERIOD, probes=self.unit.probes, capacity=1024
            )
            self.reader = TimingReader.open(tmp_path / "ring")
            self.node = Node(
                self.unit, self.transport, clock, ring, contract, monotonic=self.time.monotonic, **options
            )

        def cycles(self, count, took_ns=0):
            for _ in range(count):
                self.unit.on_step = lambda: setattr(self.time, "now_ns", self.time.now_ns + took_ns)
                assert self.node.cycle()

    return Bench


def test_input_that_waits_is_seen_by_the_same_cycle_and_its_output_is_sent(bench, protected):
    b = bench()
    motion = protected("ODO_Motion")
    b.transport.waiting.append(Frame(b.time.realtime(), 0x184, motion(Position=42.0)))
    b.cycles(1)
    now, position, age = b.unit.steps[0]
    assert now % PERIOD == 700_000
    assert position == pytest.approx(42.0)
    assert 0 < age <= PERIOD
    assert 0x181 in dict(b.transport.log)


def test_ring_gets_one_record_a_cycle_with_its_stamps_in_order(bench):
    b = bench()
    b.cycles(5, took_ns=2_000_000)
    records = b.reader.read_new()
    assert records["cycle"].tolist() == [0, 1, 2, 3, 4]
    assert records["scheduled_ns"].tolist() == [step[0] for step in b.unit.steps]
    for earlier, later in [("scheduled_ns", "woke_ns"), ("woke_ns", "read_ns"), ("stepped_ns", "sent_ns")]:
        assert (records[earlier] <= records[later]).all()
    assert (records["stepped_ns"] - records["read_ns"] >= 2_000_000).all()
    assert records["half"].tolist() == [0.5, 1.0, 1.5, 2.0, 2.5]


def test_unit_is_told_its_worst_timing_of_the_last_100_ms(bench):
    b = bench()
    b.cycles(1)
    assert b.unit.timing.execution_ns == 0  # the first cycle knows of none before it
    b.cycles(1, took_ns=3_000_000)
    b.cycles(9, took_ns=100_000)
    assert b.unit.timing.execution_ns >= 3_000_000
    b.cycles(2, took_ns=100_000)
    assert 100_000 <= b.unit.timing.execution_ns < 1_000_000
    assert 0 <= b.unit.timing.wakeup_latency_ns < 1_000


def test_every_release_that_an_overrun_passes_is_a_missed_deadline_in_a_row(bench):
    b = bench(overload=OverloadPolicy(startup_ns=0))
    b.cycles(1)
    b.cycles(1, took_ns=35_000_000)
    b.cycles(2)
    assert b.reader.read_new()["missed"].tolist() == [0, 0, 3, 0]
    report = b.node.report()
    assert (report["cycles"], report["missed"], report["skipped"]) == (4, 3, 3)
    assert report["max_consecutive_misses"] == 3
    assert b.unit.timing.deadline_misses == 3
    starts = [step[0] for step in b.unit.steps]
    assert [after - before for before, after in itertools.pairwise(starts)] == [
        PERIOD,
        4 * PERIOD,
        PERIOD,
    ]


def test_a_long_stall_is_as_many_misses_as_it_has_periods(bench):
    b = bench(overload=OverloadPolicy(startup_ns=0))
    b.cycles(1)
    b.cycles(1, took_ns=50 * PERIOD + PERIOD // 2)
    b.cycles(1)
    report = b.node.report()
    assert report["missed"] == report["max_consecutive_misses"] == 50


def test_misses_while_starting_up_are_counted_apart(bench):
    b = bench(overload=OverloadPolicy(startup_ns=20_000_000, maximum=0))
    b.cycles(2, took_ns=12_000_000)
    b.cycles(3)
    report = b.node.report()
    assert (report["missed_startup"], report["missed"], report["max_consecutive_misses"]) == (2, 0, 0)


def test_misses_never_halt_the_node_unless_the_policy_says_so(bench):
    b = bench(overload=OverloadPolicy(startup_ns=0))
    b.cycles(20, took_ns=12_000_000)
    assert b.node.report()["max_consecutive_misses"] == 20


@pytest.mark.parametrize(
    ("policy", "halts_in", "words"),
    [
        (OverloadPolicy(startup_ns=0, maximum=3), 4, "4 deadlines missed in all"),
        (OverloadPolicy(startup_ns=0, maximum_consecutive=2), 3, "3 deadlines missed in a row"),
    ],
)
def test_overload_policy_halts_the_node(bench, policy, halts_in, words):
    b = bench(overload=policy)
    b.cycles(halts_in - 1, took_ns=12_000_000)
    with pytest.raises(DeadlinesMissed, match=words) as caught:
        b.cycles(1, took_ns=12_000_000)
    assert caught.value.exit_code == 3


def test_good_cycle_ends_a_row_of_misses(bench):
    b = bench(overload=OverloadPolicy(startup_ns=0, maximum_consecutive=2))
    for _ in range(5):
        b.cycles(2, took_ns=12_000_000)
        b.cycles(1)
    assert b.node.report()["max_consecutive_misses"] == 2


def test_run_ends_when_asked_and_stop_sends_the_safe_outputs_last(bench, contract):
    b = bench()
    b.node.run(lambda: len(b.unit.steps) >= 3)
    assert len(b.unit.steps) == 3
    b.node.stop()
    command = contract.message("ATO_Command")
    can_id, data = b.transport.log[-1]
    assert can_id == command.can_id
    values = command.decode(data)
    assert (values["EffortDemand"], values["EmergencyBrake"]) == (pytest.approx(-1.0), 1)


def test_lost_bus_ends_the_run(bench):
    b = bench()
    b.cycles(1)
    b.transport.error = BusLost("the hub has gone")
    with pytest.raises(BusLost, match="hub"):
        b.node.run()


def test_report_counts_frames_and_received_messages(bench, protected):
    b = bench()
    motion = protected("ODO_Motion")
    first = motion()
    for data in (first, first, motion(), bytes(8)):
        b.transport.waiting.append(Frame(b.time.realtime(), 0x184, data))
    b.cycles(20)
    report = b.node.report()
    assert report["e2e"] == {"ODO_Motion": {"ok": 2, "rejected": 2, "lost": 0, "timeouts": 1}}
    counted = {name: report["frames"][name] for name in ("sent", "received", "dropped", "error_frames")}
    assert counted == {"sent": len(b.transport.log), "received": 4, "dropped": 0, "error_frames": 0}


def test_warm_up_sends_nothing_and_leaves_no_trace(bench, contract):
    b = bench()
    b.node.warm_up()
    assert b.unit.warm
    assert b.transport.log == []
    assert len(b.reader.read_new()) == 0
    b.cycles(1)
    counter = contract.message("ATO_Command").signal("Counter")
    data = dict(b.transport.log)[0x181]
    assert counter.start_bit == 8
    assert data[1] & 0x0F == 0  # the first one carries counter 0
    assert b.node.report()["e2e"]["ODO_Motion"]["ok"] == 0


def test_node_without_a_ring_runs(bench):
    b = bench()
    b.node.ring = None
    b.cycles(2)
    assert len(b.reader.read_new()) == 0
