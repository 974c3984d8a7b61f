import copy

import pytest

from hil.bench.outcome import Outcome
from hil.bench.summary import frames_lost
from hil.bench.watch import Ending
from hil.canbus.transport import BusOptions


def node(sent=100, dropped=0, lost=0):
    e2e = {"ODO_Motion": {"ok": 50, "rejected": 0, "lost": lost, "timeouts": 0}}
    return {"frames": {"sent": sent, "received": 90, "dropped": dropped}, "e2e": e2e}


@pytest.fixture
def outcome():
    return Outcome(
        ending=Ending("arrived", ""),
        bus=BusOptions("hil", "x"),
        started="",
        wall_time_s=1.0,
        simulated_time_s=1.0,
        one_process=False,
        nodes={"controller": node(), "plant_sim": node()},
        recorder={"frames": 210, "dropped": 0, "counter_lost": {}, "rings": {}},
        bench_sent=10,
    )


def test_nothing_is_lost_when_all_that_was_sent_is_on_record(outcome):
    assert frames_lost(outcome) == 0


def test_a_frame_that_was_sent_and_is_not_on_record_is_lost(outcome):
    outcome.recorder["frames"] = 207
    assert frames_lost(outcome) == 3


@pytest.mark.parametrize(
    ("where", "change"),
    [
        ("nodes", {"controller": node(dropped=1), "plant_sim": node()}),
        ("nodes", {"controller": node(), "plant_sim": node(lost=1)}),
        ("recorder", {"frames": 210, "dropped": 1, "counter_lost": {}, "rings": {}}),
        ("recorder", {"frames": 210, "dropped": 0, "counter_lost": {"ODO_Motion": 1}, "rings": {}}),
        ("bench_dropped", 1),
    ],
)
def test_every_witness_of_a_loss_counts(outcome, where, change):
    setattr(outcome, where, copy.deepcopy(change))
    assert frames_lost(outcome) == 1


@pytest.mark.parametrize("silent", ["controller", "plant_sim"])
def test_a_node_that_did_not_end_well_leaves_the_losses_unknown(outcome, silent):
    outcome.nodes[silent] = {}
    assert frames_lost(outcome) is None


def test_without_the_recorders_account_the_losses_are_unknown(outcome):
    outcome.recorder = {}
    assert frames_lost(outcome) is None
