from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller.config import SupervisionConfig
from controller.outputs import ERROR_CODES
from controller.supervision import Observation, Reaction, Supervision, Supervisor

PERIOD_S = 0.01
CONFIG = SupervisionConfig()
HEALTHY = Observation(speed_mps=10.0, standstill=False, permitted_mps=15.0)


class Watch:
    """A supervisor that has seen a healthy train, and keeps the last observation."""

    def __init__(self, **first):
        self.supervisor = Supervisor(CONFIG, period_s=PERIOD_S)
        self.seen = replace(HEALTHY, **first)
        self.see()

    def see(self, cycles=1, **changes):
        self.seen = replace(self.seen, **changes)
        for _ in range(cycles):
            self.supervisor.update(self.seen)
        return self.supervisor.state, self.supervisor.reaction

    def slow_down_to(self, speed):
        """Gently enough to stay plausible."""
        while abs(self.seen.speed_mps - speed) > 1e-9:
            step = max(-0.01, min(0.01, speed - self.seen.speed_mps))
            self.see(speed_mps=self.seen.speed_mps + step)


def test_a_healthy_train_is_left_to_the_law():
    assert Watch().see(1000) == (Supervision.NORMAL, Reaction.NONE)


def test_before_the_first_complete_inputs_it_waits():
    supervisor = Supervisor(CONFIG, period_s=PERIOD_S)
    for missing in ("odometry_alive", "odometry_valid", "traction_alive", "brake_alive", "permission_alive"):
        supervisor.update(replace(HEALTHY, driving=False, **{missing: False}))
        assert supervisor.state is Supervision.WAITING_FOR_INPUTS
        assert supervisor.reaction is Reaction.NONE
    supervisor.update(replace(HEALTHY, driving=False))
    assert supervisor.state is Supervision.NORMAL


@pytest.mark.parametrize(
    ("cause", "state", "reaction"),
    [
        ({"emergency_stop": True}, Supervision.EMERGENCY_STOP_ORDERED, Reaction.EMERGENCY_BRAKE),
        ({"brake_alive": False}, Supervision.BRAKE_LOST, Reaction.EMERGENCY_BRAKE),
        (
            {
                "brake_alive": False,
                "odometry_alive": False,
                "traction_alive": False,
                "permission_alive": False,
            },
            Supervision.BUS_LOST,
            Reaction.EMERGENCY_BRAKE,
        ),
        ({"distance_to_stop_m": -1.1}, Supervision.STOP_OVERRUN, Reaction.SERVICE_BRAKE),
        ({"odometry_alive": False}, Supervision.ODOMETRY_LOST, Reaction.SERVICE_BRAKE),
        ({"odometry_valid": False}, Supervision.ODOMETRY_INVALID, Reaction.SERVICE_BRAKE),
        ({"permission_alive": False}, Supervision.PERMISSION_LOST, Reaction.SERVICE_BRAKE),
        ({"departure_authorised": False}, Supervision.PERMISSION_LOST, Reaction.SERVICE_BRAKE),
        ({"doors_closed": False}, Supervision.PERMISSION_LOST, Reaction.SERVICE_BRAKE),
        ({"permitted_mps": 9.1}, Supervision.OVERSPEED_BRAKE, Reaction.SERVICE_BRAKE),
        ({"permitted_mps": 9.5}, Supervision.OVERSPEED_WARNING, Reaction.NO_TRACTION),
        ({"traction_alive": False}, Supervision.TRACTION_LOST, Reaction.NO_TRACTION),
        ({"traction_able": False}, Supervision.TRACTION_LOST, Reaction.NO_TRACTION),
        ({"deadline_misses": 10}, Supervision.DEADLINES_MISSED, Reaction.SERVICE_BRAKE),
        ({"balise_missed": True}, Supervision.BALISE_MISSED, Reaction.NONE),
    ],
    ids=lambda value: value.name if isinstance(value, Supervision) else "",
)
def test_each_cause_has_its_state_and_reaction_at_once(cause, state, reaction):
    assert Watch().see(**cause) == (state, reaction)


def test_speed_within_the_margin_is_tolerated():
    assert Watch().see(permitted_mps=9.7)[0] is Supervision.NORMAL


def test_overspeed_ends_at_the_permitted_speed_and_not_before():
    watch = Watch()
    watch.see(permitted_mps=9.0)
    watch.slow_down_to(9.1)
    assert watch.see()[0] is Supervision.OVERSPEED_BRAKE
    watch.slow_down_to(8.99)
    assert watch.see() == (Supervision.NORMAL, Reaction.NONE)


def test_an_overspeed_warning_becomes_braking_when_it_grows():
    watch = Watch()
    assert watch.see(permitted_mps=9.5)[0] is Supervision.OVERSPEED_WARNING
    assert watch.see(permitted_mps=9.0)[0] is Supervision.OVERSPEED_BRAKE
    assert watch.see(permitted_mps=9.5)[0] is Supervision.OVERSPEED_BRAKE


@pytest.mark.parametrize(
    ("cause", "good"),
    [
        ({"permission_alive": False}, {"permission_alive": True}),
        ({"doors_closed": False}, {"doors_closed": True}),
        ({"traction_alive": False}, {"traction_alive": True}),
        ({"odometry_valid": False}, {"odometry_valid": True}),
        ({"odometry_alive": False}, {"odometry_alive": True}),
    ],
)
def test_recovery_takes_its_time(cause, good):
    watch = Watch()
    watch.see(3, **cause)
    cycles = round(CONFIG.recovery_s / PERIOD_S)
    assert watch.see(cycles - 1, **good)[0] is not Supervision.NORMAL
    assert watch.see()[0] is Supervision.NORMAL


def test_a_flickering_input_does_not_recover():
    watch = Watch()
    for _ in range(50):
        watch.see(permission_alive=False)
        assert watch.see(20, permission_alive=True)[0] is Supervision.PERMISSION_LOST


@pytest.mark.parametrize("lost", [{"odometry_alive": False}, {"odometry_valid": False}])
def test_odometry_lost_for_long_becomes_an_emergency_for_good(lost):
    watch = Watch()
    watch.see(round(CONFIG.odometry_grace_s / PERIOD_S), **lost)
    assert watch.supervisor.reaction is Reaction.SERVICE_BRAKE
    assert watch.see()[1] is Reaction.EMERGENCY_BRAKE
    watch.see(1000, odometry_alive=True, odometry_valid=True, standstill=True)
    assert watch.supervisor.reaction is Reaction.EMERGENCY_BRAKE


def test_an_implausible_jump_of_speed_is_not_believed():
    watch = Watch()
    assert watch.see(speed_mps=10.3)[0] is Supervision.ODOMETRY_INVALID


def test_a_jump_of_speed_under_slip_is_expected():
    watch = Watch()
    assert watch.see(speed_mps=10.3, slipping=True)[0] is Supervision.NORMAL


def test_a_change_over_lost_frames_is_judged_by_its_time():
    watch = Watch()
    watch.see(20, odometry_fresh=False)
    assert watch.see(odometry_fresh=True, speed_mps=9.5)[0] is Supervision.NORMAL


def test_an_emergency_stop_holds_until_withdrawn_and_standing():
    watch = Watch()
    watch.see(emergency_stop=True)
    assert watch.see(100, emergency_stop=False)[0] is Supervision.EMERGENCY_STOP_ORDERED
    watch.see(emergency_stop=True, driving=False)
    watch.slow_down_to(0.0)
    assert watch.see(10, standstill=True)[0] is Supervision.EMERGENCY_STOP_ORDERED
    assert watch.see(emergency_stop=False)[0] is Supervision.NORMAL


@pytest.mark.parametrize("cause", [{"brake_alive": False}, {"speed_mps": -0.2, "standstill": False}])
def test_other_emergencies_are_for_good(cause):
    watch = Watch(speed_mps=0.0)
    watch.see(2, **cause)
    assert watch.supervisor.reaction is Reaction.EMERGENCY_BRAKE
    watch.see(1000, brake_alive=True, speed_mps=0.0, standstill=True, driving=False)
    assert watch.supervisor.reaction is Reaction.EMERGENCY_BRAKE


def test_an_order_does_not_release_an_emergency_of_another_cause():
    watch = Watch()
    watch.see(brake_alive=False)
    watch.see(10, emergency_stop=True)
    assert watch.see(10, emergency_stop=False, standstill=True, brake_alive=True)[0] is Supervision.BRAKE_LOST


def test_rolling_back_by_distance_is_an_emergency():
    watch = Watch(speed_mps=0.0, position_m=0.0)
    for k in range(1, 70):
        state, _ = watch.see(speed_mps=max(-0.1, -0.02 * k), position_m=-0.005 * k)
    assert state is Supervision.ROLL_BACK


def test_a_centimetre_back_at_departure_is_tolerated():
    watch = Watch(speed_mps=0.0, position_m=0.0)
    assert watch.see(20, speed_mps=-0.03, position_m=-0.01)[0] is Supervision.NORMAL


def test_a_balise_that_corrects_the_position_backward_is_no_roll_back():
    watch = Watch(position_m=100.0)
    assert watch.see(10, position_m=98.0)[0] is Supervision.NORMAL


def test_overrun_is_for_good():
    watch = Watch()
    watch.see(distance_to_stop_m=-1.5)
    assert watch.see(500, distance_to_stop_m=0.0)[0] is Supervision.STOP_OVERRUN


def test_a_few_missed_cycles_are_tolerated_and_too_many_are_not():
    watch = Watch()
    for k in range(1, 60):  # one in ten cycles: as many as decay
        assert watch.see(10, deadline_misses=k)[0] is Supervision.NORMAL
    assert watch.see(deadline_misses=60 + 12)[0] is Supervision.DEADLINES_MISSED
    assert watch.see(50)[0] is Supervision.DEADLINES_MISSED
    assert watch.see(200)[0] is Supervision.NORMAL


def test_misses_before_departure_do_not_count():
    watch = Watch(driving=False)
    watch.see(deadline_misses=500)
    assert watch.see(driving=True)[0] is Supervision.NORMAL


@pytest.mark.parametrize("lost", ["permission_alive", "traction_alive", "brake_alive"])
def test_at_the_platform_a_silent_unit_means_waiting(lost):
    watch = Watch(driving=False, speed_mps=0.0, standstill=True)
    assert watch.see(**{lost: False}) == (Supervision.WAITING_FOR_INPUTS, Reaction.NONE)


def test_at_the_platform_doors_may_open():
    watch = Watch(driving=False, speed_mps=0.0, standstill=True)
    assert watch.see(100, doors_closed=False, departure_authorised=False)[0] is Supervision.NORMAL


observations = st.builds(
    Observation,
    driving=st.booleans(),
    odometry_alive=st.booleans(),
    odometry_valid=st.booleans(),
    traction_alive=st.booleans(),
    brake_alive=st.booleans(),
    permission_alive=st.booleans(),
    departure_authorised=st.booleans(),
    emergency_stop=st.booleans(),
    standstill=st.booleans(),
    speed_mps=st.floats(-50, 50),
    position_m=st.floats(-1e4, 1e5),
    permitted_mps=st.floats(0, 50),
    distance_to_stop_m=st.floats(-100, 1e5),
    deadline_misses=st.integers(0, 1000),
)


@given(st.lists(observations, min_size=1, max_size=40))
def test_a_withdrawn_departure_always_brakes_a_driven_train(seen):
    supervisor = Supervisor(CONFIG, period_s=PERIOD_S)
    supervisor.update(replace(HEALTHY))
    for observation in seen:
        supervisor.update(observation)
        if observation.driving and not (observation.permission_alive and observation.departure_authorised):
            assert supervisor.reaction >= Reaction.SERVICE_BRAKE
        if observation.emergency_stop:
            assert supervisor.reaction is Reaction.EMERGENCY_BRAKE


def test_numbers_are_those_of_the_bus_contract(contract):
    signals = {signal.name: signal for signal in contract.message("ATO_Status").signals}
    assert {state.value: state.name for state in Supervision} == dict(signals["Supervision"].choices)


def test_every_state_has_an_error_code_of_the_bus_contract(contract):
    signals = {signal.name: signal for signal in contract.message("ATO_Emergency").signals}
    assert set(ERROR_CODES) == set(Supervision)
    assert set(ERROR_CODES.values()) <= set(signals["ErrorCode"].choices.values())


def test_a_position_that_the_speed_does_not_explain_is_not_believed():
    watch = Watch(position_m=100.0)
    assert watch.see(position_m=114.0) == (Supervision.NORMAL, Reaction.NONE)  # a balise may correct so much
    assert watch.see(position_m=130.0) == (Supervision.ODOMETRY_INVALID, Reaction.SERVICE_BRAKE)
    assert watch.see(49)[0] is Supervision.ODOMETRY_INVALID
    assert watch.see(2)[0] is Supervision.NORMAL


@pytest.mark.parametrize("how", ["silent", "invalid", "missed"])
def test_the_way_made_in_the_dark_is_plausible(how):
    """Two seconds without odometry, or of own missed cycles, at 10 m/s are 20 m."""
    watch = Watch(position_m=100.0)
    if how == "silent":
        watch.see(200, odometry_fresh=False)
    elif how == "invalid":
        watch.see(200, odometry_valid=False)
    missed = 200 if how == "missed" else 0
    watch.seen = replace(watch.seen, driving=how == "silent")
    hold_before = watch.supervisor._odometry_bad_cycles
    watch.see(odometry_fresh=True, odometry_valid=True, position_m=120.0, deadline_misses=missed)
    assert watch.supervisor._odometry_bad_cycles == hold_before


def test_a_balise_from_far_away_speaks_against_the_odometry():
    watch = Watch()
    assert watch.see(balise_far=True)[0] is Supervision.ODOMETRY_INVALID
    assert watch.see(60, balise_far=False)[0] is Supervision.NORMAL


def test_an_overrun_that_implausible_odometry_claims_does_not_latch():
    watch = Watch(position_m=100.0, distance_to_stop_m=50.0)
    assert watch.see(position_m=160.0, distance_to_stop_m=-10.0)[0] is Supervision.ODOMETRY_INVALID
    watch.see(position_m=100.0, distance_to_stop_m=50.0)
    assert watch.see(60)[0] is Supervision.NORMAL


@pytest.mark.parametrize("overrun_m", [1.5, 6.0])
def test_an_overrun_stays_when_the_odometry_is_good(overrun_m):
    watch = Watch(distance_to_stop_m=-overrun_m, speed_mps=0.5)
    assert watch.see(500)[0] is Supervision.STOP_OVERRUN
