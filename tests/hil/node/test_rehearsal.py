"""The rehearsal: a twin one cycle behind, no side effects, and never at the expense of a deadline."""

from __future__ import annotations

import pytest

from hil.canbus.frame import Frame
from hil.node import Node, OverloadPolicy, RealTimeClock
from hil.node.rehearsal import PATIENCE, Rehearsal, rehearsal_of
from hil.node.spin import SpinChoice

PERIOD = 10_000_000


@pytest.fixture
def bench(contract, fakes):
    """A node in real time on a fake clock, with a twin of its unit."""

    class Bench:
        def __init__(self, *, takes_ns=400_000, margin_ns=200_000, longest_ns=None, twin=True):
            self.time = fakes.Time()
            self.transport = fakes.Transport()
            self.unit, self.twin = fakes.Unit(), fakes.Unit()
            self.takes_ns = takes_ns
            self.twin.on_step = self._pass
            self.rehearsal = Rehearsal(self.twin, contract, monotonic=self.time.monotonic) if twin else None
            self.clock = RealTimeClock(
                PERIOD, 700_000, monotonic=self.time.monotonic, sleep_until=self.time.sleep_until,
                realtime=self.time.realtime, transport=self.transport, rehearsal=self.rehearsal,
                spin=SpinChoice("auto", "test", margin_ns, longest_ns or margin_ns),
            )  # fmt: skip
            self.node = Node(
                self.unit, self.transport, self.clock, None, contract, monotonic=self.time.monotonic,
                overload=OverloadPolicy(startup_ns=0),
            )  # fmt: skip

        def _pass(self):
            self.time.now_ns += self.takes_ns

        def cycles(self, motion, count):
            late = []
            for k in range(count):
                data = motion(Position=float(k))
                self.transport.waiting.append(Frame(self.time.realtime(), 0x184, data))
                before = len(self.unit.steps)
                assert self.node.cycle()
                late.append(self.node.inbox.timing.wakeup_latency_ns)
                assert len(self.unit.steps) == before + 1
            return late

    return Bench


def test_twin_gets_what_the_unit_got_one_cycle_before(bench, protected):
    b = bench()
    b.cycles(protected("ODO_Motion"), 20)
    assert b.rehearsal.runs == 20
    # before the first cycle there is nothing to repeat but the time
    assert [step[:2] for step in b.twin.steps[1:]] == [step[:2] for step in b.unit.steps[:-1]]
    assert b.twin.steps[0][0] == b.unit.steps[0][0] - PERIOD


def test_rehearsal_changes_nothing_that_is_sent_or_read(bench, protected):
    with_twin, without = bench(), bench(twin=False)
    for b in (with_twin, without):
        b.cycles(protected("ODO_Motion"), 30)
    assert with_twin.transport.log == without.transport.log
    assert [s[1] for s in with_twin.unit.steps] == [s[1] for s in without.unit.steps]
    reports = [b.node.report() for b in (with_twin, without)]
    assert reports[0]["e2e"] == reports[1]["e2e"]
    assert reports[0]["frames"] == reports[1]["frames"]


def test_rehearsal_ends_before_the_deadline(bench, protected):
    b = bench(takes_ns=600_000)
    assert max(b.cycles(protected("ODO_Motion"), 50)) < 1_000
    assert b.rehearsal.runs == 50
    assert b.node.report()["missed"] == 0


def test_late_wake_up_skips_the_rehearsal(bench, protected):
    b = bench()
    motion = protected("ODO_Motion")
    b.cycles(motion, 5)
    b.time.oversleep_ns = 800_000
    runs = b.rehearsal.runs
    b.cycles(motion, 3)
    assert b.rehearsal.runs == runs
    assert b.rehearsal.skipped == 3


def test_lead_follows_what_a_rehearsal_takes(bench, protected):
    b = bench(takes_ns=150_000)
    b.cycles(protected("ODO_Motion"), 3000)
    assert 150_000 <= b.rehearsal.lead.now_ns <= 250_000


def settled(bench):
    """A node whose lead has come down to its rehearsals of 300 us, its margin to the smallest, 100 us."""
    b = bench(takes_ns=300_000, margin_ns=100_000, longest_ns=300_000)
    for _ in range(5000):
        b.clock.margin.observe(0)
        b.rehearsal.lead.observe(b.takes_ns)
    assert b.clock.margin.now_ns == 100_000
    assert 300_000 < b.rehearsal.lead.now_ns < 350_000
    return b


def test_rehearsals_longer_than_their_lead_widen_the_margin_of_the_poll(bench, protected):
    b = settled(bench)
    motion = protected("ODO_Motion")
    assert max(b.cycles(motion, 20)) < 1_000
    assert b.clock.margin.now_ns == 100_000
    b.takes_ns = 450_000  # the end of it would be past the deadline
    b.cycles(motion, 1)
    assert 100_000 < b.clock.margin.now_ns <= 125_000
    # Margin and lead grow until both together hold it again.
    b.cycles(motion, 30)
    assert 110_000 < b.clock.margin.now_ns <= 300_000
    runs = b.rehearsal.runs
    assert max(b.cycles(motion, 30)[12:]) < 1_000  # the window of the latency is 10 cycles long
    assert b.rehearsal.runs == runs + 30


def test_late_sleep_and_long_rehearsal_together_widen_the_margin(bench, protected):
    alone = []
    for oversleep_ns, takes_ns in ((60_000, 300_000), (0, 360_000), (60_000, 360_000)):
        b = settled(bench)
        b.time.oversleep_ns, b.takes_ns = oversleep_ns, takes_ns
        b.cycles(protected("ODO_Motion"), 1)
        alone.append(b.clock.margin.now_ns > 100_000)
    assert alone == [False, False, True]


def test_rehearsal_that_takes_too_long_is_given_up(bench, protected):
    b = bench(takes_ns=2_000_000)
    b.cycles(protected("ODO_Motion"), 3 * PATIENCE)
    assert b.clock.rehearsal is None
    assert b.rehearsal.runs == PATIENCE + 1
    assert "longer than 1000 us" in b.node.report()["rehearsal"]["failure"]


def test_twin_that_fails_ends_rehearsals_and_not_the_node(bench, protected):
    b = bench()

    def fail():
        raise ZeroDivisionError("the twin")

    b.twin.on_step = fail
    b.cycles(protected("ODO_Motion"), 5)
    assert len(b.unit.steps) == 5
    assert len(b.twin.steps) == 1
    assert b.node.report()["rehearsal"]["failure"] == "ZeroDivisionError: the twin"


def test_no_rehearsal_without_a_twin_nor_where_it_costs_too_much(contract, fakes):
    slow, fast = fakes.Unit(), fakes.Unit(period_ns=1_000_000)
    assert rehearsal_of(slow, contract) is None
    slow.twin, fast.twin = fakes.Unit, lambda: fakes.Unit(period_ns=1_000_000)
    rehearsal = rehearsal_of(slow, contract)
    assert rehearsal is not None
    assert rehearsal.lead.largest_ns <= 0.08 * slow.period_ns
    assert rehearsal_of(fast, contract) is None


def test_clock_that_only_sleeps_does_not_rehearse(contract, fakes):
    clock = RealTimeClock(PERIOD, 0, 0, rehearsal=Rehearsal(fakes.Unit(), contract))
    assert clock.rehearsal is None
