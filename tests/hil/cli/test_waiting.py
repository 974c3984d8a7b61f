"""How a node waits, in words."""

from hil.cli.waiting import waiting_words
from hil.node.spin import AdaptiveMargin, choose_spin, spin_report


def told(asked_ns, *, cpus=2):
    choice = choose_spin(asked_ns, 10_000_000, cpus=cpus, rt_share=1.0)
    return spin_report(choice, AdaptiveMargin(choice.smallest_ns, choice.largest_ns), 10_000_000)


def test_poll_and_rehearsal_are_said_with_their_lengths():
    spin = told(200_000)
    assert waiting_words(spin, None) == "polls for the last 200 us before a deadline"
    assert waiting_words(spin, {"runs": 0, "lead_ns": 1}) == waiting_words(spin, None)
    both = waiting_words(spin, {"runs": 9, "lead_ns": 340_000})
    assert both == "polls for the last 200 us before a deadline, rehearses 340 us before that"


def test_a_node_that_only_sleeps_says_why():
    assert waiting_words(None, None) == "only sleeps"
    assert waiting_words(told(0), None) == "only sleeps (asked for)"
    assert "one CPU" in waiting_words(told(None, cpus=1), None)
