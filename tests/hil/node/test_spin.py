"""The spin: chosen from what the machine allows, a margin that follows what sleeps really overshoot."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.node.spin import AdaptiveMargin, choose_spin, real_time_share, spin_report

MS = 1_000_000


def settled(overshoots_ns, smallest=0, largest=10**7):
    margin = AdaptiveMargin(smallest, largest)
    history = []
    for overshoot in overshoots_ns:
        margin.observe(int(overshoot))
        history.append(margin.now_ns)
    return np.array(history)


@given(st.lists(st.integers(-(10**6), 10**10), max_size=200), st.integers(0, 10**6), st.integers(0, 10**6))
def test_margin_stays_between_its_limits(overshoots, one, other):
    smallest, largest = sorted((one, other))
    margin = AdaptiveMargin(smallest, largest)
    assert margin.now_ns == largest  # a machine that is not known yet is taken for a bad one
    for overshoot in overshoots:
        margin.observe(overshoot)
        assert smallest <= margin.now_ns <= largest


def test_margin_settles_where_two_of_a_thousand_sleeps_overshoot_it():
    """Against numpy's percentile of the same distribution."""
    rng = np.random.default_rng(5)
    overshoots = 30_000 + rng.gamma(2.0, 15_000.0, 100_000)
    history = settled(overshoots, largest=500_000)
    late = float(np.percentile(overshoots, 99.8))
    assert np.median(history[30_000:]) - 20_000 == pytest.approx(late, rel=0.15)


def test_margin_of_a_quiet_machine_sinks_to_the_smallest():
    assert settled([5_000] * 10_000, 100_000, 300_000)[-1] == 100_000


def test_single_stall_widens_the_margin_by_one_step_and_is_forgotten():
    quiet = [20_000] * 6_000
    history = settled([*quiet, 30_000_000, *quiet], 100_000, 300_000)
    before, after = history[len(quiet) - 1], history[len(quiet)]
    assert before == 100_000
    assert before < after <= before + 25_000
    assert history[len(quiet) + 600] == 100_000


def test_lasting_load_widens_the_margin_within_a_dozen_cycles():
    history = settled([*[20_000] * 6_000, *[400_000] * 12], 100_000, 300_000)
    assert history[-1] == 300_000


def test_equal_limits_are_a_fixed_margin():
    margin = AdaptiveMargin(70_000, 70_000)
    for overshoot in (0, 10**9, 5):
        margin.observe(overshoot)
        assert margin.now_ns == 70_000


@pytest.mark.parametrize(("smallest", "largest"), [(-1, 5), (6, 5)])
def test_limits_out_of_order_are_refused(smallest, largest):
    with pytest.raises(ValueError, match="in order"):
        AdaptiveMargin(smallest, largest)


@pytest.mark.parametrize(
    ("asked", "period", "cpus", "share", "mode", "limits"),
    [
        (None, 10 * MS, 2, 0.95, "auto", (100_000, 300_000)),
        (None, 1 * MS, 2, 0.95, "auto", (100_000, 250_000)),  # a quarter of a CPU
        (None, 1 * MS, 2, 0.3, "auto", (100_000, 150_000)),  # half of what the throttle leaves
        (None, 10 * MS, 1, 0.95, "off", (0, 0)),
        (None, 250_000, 8, 1.0, "off", (0, 0)),
        (0, 10 * MS, 2, 0.95, "off", (0, 0)),
        (80_000, 10 * MS, 1, 0.95, "fixed", (80_000, 80_000)),
        (10 * MS, 10 * MS, 2, 0.95, "fixed", (5 * MS, 5 * MS)),
    ],
)
def test_choice_by_request_period_and_machine(asked, period, cpus, share, mode, limits):
    choice = choose_spin(asked, period, cpus=cpus, rt_share=share)
    assert (choice.mode, (choice.smallest_ns, choice.largest_ns)) == (mode, limits)
    assert choice.why


@given(st.integers(1, 10**9), st.integers(1, 64), st.floats(0, 1))
def test_automatic_spin_never_takes_more_than_a_quarter_of_a_cpu(period, cpus, share):
    choice = choose_spin(None, period, cpus=cpus, rt_share=share)
    assert choice.largest_ns <= period * min(0.25, share / 2)


@pytest.mark.parametrize(
    ("texts", "share"), [(("950000", "1000000"), 0.95), (("-1", "1000000"), 1.0), (("x", "1"), 1.0)]
)
def test_throttle_is_read_from_the_kernel(texts, share):
    answers = iter(texts)
    assert real_time_share(lambda path: next(answers)) == share


def test_system_without_a_throttle_leaves_everything():
    def read(path):
        raise FileNotFoundError(path)

    assert real_time_share(read) == 1.0


def test_report_states_the_cpu_share():
    choice = choose_spin(None, 10 * MS, cpus=2, rt_share=1.0)
    report = spin_report(choice, choice.margin(), 10 * MS)
    assert (report["mode"], report["margin_ns"], report["cpu_share"]) == ("auto", 300_000, 0.03)
