import pytest

from hil.bench.watch import GIVE_UP_S, SETTLE_S, Watch
from hil.canbus.contract import Contract

MODES = {"READY": 1, "RUN": 2, "STOPPING": 3, "HOLD": 4, "EMERGENCY": 6}


@pytest.fixture(scope="module")
def contract():
    return Contract.load()


@pytest.fixture
def bench(contract):
    watch = Watch(contract, time_limit_s=200.0, departure_limit_s=20.0)

    def see(time_s, mode, *, speed=0.0, controlled=True):
        for name, values in (
            ("ATO_Status", {"Mode": MODES[mode]}),
            ("ODO_Motion", {"Speed": speed, "Standstill": int(speed == 0.0), "Position": 12.5}),
        ):
            codec = contract.message(name)
            watch.hear(codec.can_id, bytes(codec.encode(values)))
        return watch.ending(watch.view(time_s), controlled=controlled)

    return see


def test_a_run_that_drives_and_then_holds_has_arrived_after_the_settling_time(bench):
    assert bench(1.0, "READY") is None
    assert bench(2.0, "RUN", speed=5.0) is None
    assert bench(80.0, "HOLD") is None
    assert bench(80.0 + SETTLE_S, "HOLD").how == "arrived"


def test_standing_before_departure_is_no_end_until_the_departure_limit(bench):
    assert bench(19.0, "READY") is None
    assert bench(20.5, "READY").how == "no_departure"


def test_a_train_that_starts_from_rest_in_run_is_not_given_up(bench):
    bench(1.0, "RUN")
    assert bench(1.0 + 2 * GIVE_UP_S, "RUN") is None


def test_a_train_braked_to_a_stand_elsewhere_has_stopped(bench):
    bench(2.0, "RUN", speed=5.0)
    assert bench(30.0, "EMERGENCY") is None
    assert bench(30.0 + GIVE_UP_S, "EMERGENCY").how == "stopped"


def test_a_train_without_controller_ends_where_it_stands(bench):
    bench(2.0, "RUN", speed=5.0)
    assert bench(3.0, "RUN", speed=4.0, controlled=False) is None
    bench(10.0, "RUN", controlled=False)
    assert bench(10.0 + GIVE_UP_S, "RUN", controlled=False).how == "stopped"


def test_a_train_under_way_for_ever_times_out(bench):
    bench(2.0, "RUN", speed=5.0)
    assert bench(201.0, "RUN", speed=5.0).how == "timeout"


def test_before_anything_is_heard_nothing_is_claimed(contract):
    view = Watch(contract, time_limit_s=10.0).view(0.0)
    assert (view.mode, view.speed_mps, view.standstill) == ("-", 0.0, True)
