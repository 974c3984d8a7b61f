from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from controller.modes import Mode
from controller.planning import plan
from controller.profile import ProfileError
from controller.supervision import Supervision
from controller.unit import COMMON_PROBES, RECEIVES, ControllerUnit, build
from hil.node.inbox import CycleTiming, Inbox
from hil.node.outbox import Outbox
from hil.railway import RailwayDataError

PERIOD_NS = 10_000_000
SERVICE_BRAKE = -0.8
BALISES = [(101, 5.0), (102, 150.0), (103, 400.0)]


@pytest.fixture
def unit(contract, journeys, configs):
    name = "cat_linh_la_thanh"
    first = plan(journeys[name], configs[name])
    unit = ControllerUnit(journeys[name], configs[name], first, contract)
    unit.first = first
    return unit


class Drive:
    """A unit on a bus whose inputs the test sets by hand."""

    def __init__(self, unit, bus):
        self.unit, self.bus, self.cycle = unit, bus, 0

    def __call__(self, cycles=1):
        for _ in range(cycles):
            self.unit.step(self.cycle * PERIOD_NS, self.bus, self.bus)
            self.cycle += 1
        return self.bus.command

    def motion(self, speed, position):
        """Bring speed and position there without a jump; balises on the way are read."""
        values, balise = self.bus["ODO_Motion"].values, self.bus["ODO_Balise"]
        values["Standstill"] = int(speed == 0.0)
        start, at = values["Speed"], values["Position"]
        steps = 2 + int(max(abs(speed - start) / 0.05, abs(position - at) / 10.0))
        for value, place in zip(
            np.linspace(start, speed, steps), np.linspace(at, position, steps), strict=True
        ):
            passed = [b for b in BALISES if values["Position"] < b[1] <= place]
            balise.events.extend({"Number": number, "Position": where} for number, where in passed)
            values.update(Speed=float(value), Position=float(place))
            self()
            balise.events.clear()


@pytest.fixture
def drive(unit, bus):
    return Drive(unit, bus)


@pytest.fixture
def running(drive):
    """In RUN at 10 m/s, where the plan is at about that speed."""
    drive(3)
    table = drive.unit.timetable.table
    position = next(float(x) for x in range(1, 400) if table.at(float(x), 1e3).speed_mps > 10.0)
    drive.motion(10.0, position)
    drive(200)
    assert drive.unit.mode is Mode.RUN
    assert drive.unit.supervisor.state is Supervision.NORMAL
    return drive


def test_it_is_a_unit_of_the_contract(unit, contract):
    assert unit.name == "controller"
    assert unit.nodes == ("ATO",)
    assert unit.after == ()
    assert unit.period_ns == PERIOD_NS
    contract.require(unit.receives)
    assert unit.receives == RECEIVES


def test_probes_begin_with_the_common_ones_and_match_their_values(running):
    unit = running.unit
    assert unit.probes[: len(COMMON_PROBES)] == COMMON_PROBES
    assert len(unit.probes) == len(unit.probe())
    values = dict(zip([probe.name for probe in unit.probes], unit.probe(), strict=True))
    assert values["measured_speed_mps"] == 10.0
    assert values["mode"] == Mode.RUN
    assert values["effort_demand"] == running.bus.command["EffortDemand"]
    expected = values["reference_speed_mps"] - 10.0
    assert values["speed_error_mps"] == pytest.approx(expected)


def test_without_inputs_it_holds_the_train_and_waits(unit, contract):
    inbox = Inbox(contract, unit.receives)
    outbox = Outbox(contract, unit.nodes, unit.period_ns, every_cycle=unit.every_cycle)
    for cycle in range(30):
        inbox.begin(cycle * PERIOD_NS)
        unit.step(cycle * PERIOD_NS, inbox, outbox)
        frames = outbox.collect(cycle)
    command = contract.message("ATO_Command").decode(dict(frames)[contract.message("ATO_Command").can_id])
    assert command["Mode"] == Mode.STANDBY
    assert command["EffortDemand"] == 0.0
    assert command["HoldingBrake"] == 1
    assert command["OdometryCounter"] == 15  # NONE
    assert unit.supervisor.state is Supervision.WAITING_FOR_INPUTS


def test_all_messages_of_the_node_are_sent(unit, contract, bus):
    outbox = Outbox(contract, unit.nodes, unit.period_ns, every_cycle=unit.every_cycle)
    sent = set()
    for cycle in range(20):
        unit.step(cycle * PERIOD_NS, bus, outbox)
        sent |= {contract.by_id[can_id].name for can_id, _ in outbox.collect(cycle)}
    assert {"ATO_Command", "ATO_Status", "ATO_Position", "ATO_Timing", "ATO_Heartbeat"} <= sent
    assert "ATO_Emergency" in sent  # WAITING_FOR_INPUTS -> NORMAL


def test_ready_waits_for_doors_and_departure(drive, bus):
    permission = bus["ATP_Permission"].values
    permission.update(DoorsClosed=0, DepartureAuthorised=0)
    assert drive(10)["Mode"] == Mode.READY
    permission.update(DepartureAuthorised=1)
    assert drive(10)["Mode"] == Mode.READY
    permission.update(DoorsClosed=1)
    assert drive()["Mode"] == Mode.RUN


def test_the_command_says_which_odometry_it_answers(drive, bus):
    bus["ODO_Motion"].counter = 7
    assert drive()["OdometryCounter"] == 7


def test_a_slow_train_gets_traction_and_a_fast_one_brake(running):
    running.bus["ODO_Motion"].values["Speed"] = 9.9
    slow = running(5)["EffortDemand"]
    running.motion(10.6, running.bus["ODO_Motion"].values["Position"])
    assert running(5)["EffortDemand"] < slow


@pytest.mark.parametrize(
    ("message", "change", "state"),
    [
        ("ATP_Permission", {"silent": True}, Supervision.PERMISSION_LOST),
        ("ATP_Permission", {"faulty": True}, Supervision.PERMISSION_LOST),
        ("ATP_Permission", {"DoorsClosed": 0}, Supervision.PERMISSION_LOST),
        ("ATP_Permission", {"DepartureAuthorised": 0}, Supervision.PERMISSION_LOST),
        ("ATP_Permission", {"PermittedSpeed": 8.0}, Supervision.OVERSPEED_BRAKE),
        ("ATP_Permission", {"PermittedSpeed": math.nan}, Supervision.PERMISSION_LOST),
        ("ODO_Motion", {"silent": True}, Supervision.ODOMETRY_LOST),
        ("ODO_Motion", {"faulty": True}, Supervision.ODOMETRY_INVALID),
        ("ODO_Motion", {"Valid": 0}, Supervision.ODOMETRY_INVALID),
        ("ODO_Motion", {"Speed": math.nan}, Supervision.ODOMETRY_INVALID),
        ("ODO_Motion", {"Position": math.inf}, Supervision.ODOMETRY_INVALID),
        ("ODO_Motion", {"Speed": 0.0}, Supervision.ODOMETRY_INVALID),
    ],
)
def test_an_override_brakes_whatever_the_law_wants(running, message, change, state):
    # The train is far too slow, so the law alone would give full traction.
    running.motion(6.0, running.bus["ODO_Motion"].values["Position"])
    assert running()["EffortDemand"] > 0.5
    running.motion(10.0, running.bus["ODO_Motion"].values["Position"])
    received = running.bus[message]
    for key, value in change.items():
        if hasattr(received, key):
            setattr(received, key, value)
        else:
            received.values[key] = value
    command = running()
    assert running.unit.supervisor.state is state
    assert command["EffortDemand"] == SERVICE_BRAKE
    assert command["Mode"] == Mode.DEGRADED
    assert not command["EmergencyBrake"]


@pytest.mark.parametrize(
    ("message", "change", "state"),
    [
        ("ATP_Permission", ("values", {"EmergencyStop": 1}), Supervision.EMERGENCY_STOP_ORDERED),
        ("BCU_Status", ("silent", True), Supervision.BRAKE_LOST),
        ("BCU_Status", ("faulty", True), Supervision.BRAKE_LOST),
    ],
)
def test_an_emergency_applies_the_emergency_brake_and_cuts_traction(running, message, change, state):
    received = running.bus[message]
    if change[0] == "values":
        received.values.update(change[1])
    else:
        setattr(received, *change)
    command = running()
    assert running.unit.supervisor.state is state
    assert command["EmergencyBrake"]
    assert command["EffortDemand"] == 0.0
    assert command["Mode"] == Mode.EMERGENCY


@pytest.mark.parametrize(("message", "state"), [("TCU_Status", 4), ("TCU_Status", 5), ("BCU_Status", 3)])
def test_no_traction_is_asked_of_a_drive_that_is_cut_or_braked(running, message, state):
    running.motion(9.0, running.bus["ODO_Motion"].values["Position"])
    assert running()["EffortDemand"] > 0.0
    running.bus[message].values["State"] = state
    assert running()["EffortDemand"] <= 0.0
    assert running.unit.supervisor.state is Supervision.TRACTION_LOST


def test_all_units_silent_is_a_lost_bus(running):
    for message in RECEIVES:
        running.bus[message].silent = True
    command = running()
    assert running.unit.supervisor.state is Supervision.BUS_LOST
    assert command["EmergencyBrake"]


def test_own_missed_deadlines_brake(running):
    running.bus.timing = CycleTiming(deadline_misses=50)
    assert running()["EffortDemand"] == SERVICE_BRAKE
    assert running.unit.supervisor.state is Supervision.DEADLINES_MISSED


def test_rolling_back_at_departure_is_an_emergency(drive):
    drive(5)
    drive.motion(-0.2, -0.1)
    assert drive.unit.supervisor.state is Supervision.ROLL_BACK
    assert drive.bus.command["EmergencyBrake"]


def test_a_missed_balise_is_reported_and_the_law_drives_on(running):
    motion = running.bus["ODO_Motion"].values
    while motion["Position"] < 166.0:
        motion["Position"] += 10.0
        command = running()
    assert running.unit.supervisor.state is Supervision.BALISE_MISSED
    assert command["Mode"] == Mode.RUN


def test_the_return_from_an_override_is_bumpless(running):
    running.bus["ATP_Permission"].values["DoorsClosed"] = 0
    running(20)
    running.bus["ATP_Permission"].values["DoorsClosed"] = 1
    running(48)
    assert running.unit.mode is Mode.DEGRADED
    demands = [running()["EffortDemand"] for _ in range(300)]
    assert running.unit.mode is Mode.RUN
    # Comfortable jerk of this train: 0.7 m/s3, of 1.4 m/s2 at full brake; 0.01 s a step.
    while_braking = [b - a for a, b in pairwise(demands) if b < 0.0]
    assert max(while_braking) <= 0.7 / 1.4 * 0.01 + 1e-9
    assert demands[-1] > demands[0] + 0.3


def test_a_change_of_supervision_is_announced_once(running):
    running.bus.events.clear()
    running.bus["ATP_Permission"].values["DoorsClosed"] = 0
    running(20)
    [(name, values)] = running.bus.events
    assert name == "ATO_Emergency"
    assert values["ErrorCode"] == 0xFF03
    assert values["SupervisionState"] == Supervision.PERMISSION_LOST
    assert values["Detail"] == 10_000
    running.bus["ATP_Permission"].values["DoorsClosed"] = 1
    running(100)
    assert running.bus.events[-1][1]["ErrorCode"] == 0
    assert running.bus.events[-1][1]["ErrorRegister"] == 0


def test_at_the_stop_it_holds(running):
    stop = running.unit.profile.end_m
    # Straight to the stop would be a jump; crawl there.
    running.motion(0.5, stop - 0.05)
    assert running.unit.mode is Mode.STOPPING
    running.motion(0.0, stop - 0.01)
    command = running()
    assert command["Mode"] == Mode.HOLD
    assert command["HoldingBrake"]
    assert command["EffortDemand"] <= 0.0


def test_past_the_stop_there_is_no_traction(running):
    stop = running.unit.profile.end_m
    running.motion(0.3, stop - 0.3)
    running.motion(0.02, stop + 0.05)
    assert running(10)["EffortDemand"] < 0.0


def test_a_train_left_moving_gets_the_emergency_brake(running):
    running.unit.stop(running.bus)
    assert running.bus.command["EmergencyBrake"]


def test_a_train_left_standing_gets_the_holding_brake(drive):
    drive(5)
    drive.unit.stop(drive.bus)
    assert drive.bus.command["HoldingBrake"]
    assert not drive.bus.command["EmergencyBrake"]
    assert drive.bus.command["Mode"] == Mode.STANDBY


def test_warming_up_leaves_no_trace(unit, bus, contract, journeys, configs):
    name = "cat_linh_la_thanh"
    cold = ControllerUnit(journeys[name], configs[name], unit.first, contract)
    unit.warm_up()
    for made in (unit, cold):
        drive = Drive(made, bus)
        drive(300)
        made.seen = (dict(bus.command), made.probe())
    assert unit.seen == cold.seen


def test_extreme_positions_and_timings_stay_inside_the_signals(unit, contract, bus):
    outbox = Outbox(contract, unit.nodes, unit.period_ns, every_cycle=unit.every_cycle)
    bus.timing = CycleTiming(wakeup_latency_ns=10**12, execution_ns=10**12, deadline_misses=10**9)
    for cycle, (speed, position) in enumerate([(91.0, 2.1e6), (-91.0, -2.1e6), (0.0, 0.0)] * 20):
        bus["ODO_Motion"].values.update(Speed=speed, Position=position)
        unit.step(cycle * PERIOD_NS, bus, outbox)
        outbox.collect(cycle)


odometry = st.fixed_dictionaries(
    {
        "Speed": st.floats(-91, 91) | st.sampled_from([math.nan, math.inf, -math.inf]),
        "Position": st.floats(-2e6, 2e6) | st.just(math.nan),
        "Valid": st.integers(0, 1),
        "Standstill": st.integers(0, 1),
        "Slip": st.integers(0, 1),
    }
)
permission = st.fixed_dictionaries(
    {
        "DoorsClosed": st.integers(0, 1),
        "DepartureAuthorised": st.integers(0, 1),
        "PermittedSpeed": st.floats(0, 180),
    }
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=st.lists(st.tuples(odometry, permission, st.booleans(), st.booleans()), min_size=1, max_size=25))
def test_whatever_comes_in_the_command_is_sound(contract, journeys, configs, tools, steps):
    name = "cat_linh_la_thanh"
    global PROFILE  # noqa: PLW0603 (planned once for all examples)
    PROFILE = PROFILE or plan(journeys[name], configs[name])
    unit = ControllerUnit(journeys[name], configs[name], PROFILE, contract)
    drive = Drive(unit, tools.Bus())
    drive(250)  # departs, so that the law is at work
    for motion, allowed, odometry_silent, permission_silent in steps:
        drive.bus["ODO_Motion"].values.update(motion)
        drive.bus["ATP_Permission"].values.update(allowed)
        drive.bus["ODO_Motion"].silent = odometry_silent
        drive.bus["ATP_Permission"].silent = permission_silent
        driven = unit.mode in (Mode.RUN, Mode.STOPPING)
        command = drive()
        demand = command["EffortDemand"]
        assert math.isfinite(demand)
        assert -1.0 <= demand <= 1.0
        measured = math.isfinite(motion["Speed"]) and math.isfinite(motion["Position"])
        if not measured or not motion["Valid"] or odometry_silent:
            assert demand <= 0.0
        if driven and (permission_silent or not (allowed["DoorsClosed"] and allowed["DepartureAuthorised"])):
            assert demand == SERVICE_BRAKE or command["EmergencyBrake"] or command["Mode"] == Mode.HOLD
        if command["EmergencyBrake"] or command["HoldingBrake"]:
            assert demand <= 0.0
        assert np.all(np.isfinite(unit.probe()))


PROFILE = None


def test_build_makes_the_unit_of_a_scenario(scenario_file, contract):
    unit = build(scenario_file("[controller]\nlaw = 'pid'\nperiod_s = 0.02\n"), contract)
    assert unit.period_ns == 20_000_000
    assert unit.profile.duration_s == pytest.approx(88.0 - 1.2, abs=0.02)


def test_a_timetable_too_short_names_file_key_and_minimum(scenario_file, contract):
    path = scenario_file("", time_s=80.0)
    with pytest.raises(ProfileError) as error:
        build(path, contract)
    text = str(error.value)
    assert text.startswith(f"{path}: journey.time_s: 80 must be at least ")
    assert error.value.exit_code == 2
    minimum = float(re.search(r"at least ([\d.]+),", text).group(1))
    assert build(scenario_file("", time_s=minimum), contract).profile.end_m == 931.0


def test_a_scenario_that_is_not_there_is_one_line(tmp_path, contract):
    with pytest.raises(RailwayDataError, match="no such file"):
        build(tmp_path / "none.toml", contract)


def test_a_controller_period_other_than_the_plants_still_plans_the_same(journeys, configs):
    name = "fuzzy_d_2km"
    other = configs[name].model_copy(update={"period_s": 0.001})
    one, two = plan(journeys[name], configs[name]), plan(replace(journeys[name]), other)
    np.testing.assert_array_equal(one.profile.speed_mps, two.profile.speed_mps)


@pytest.mark.parametrize("overrun_m", [1.5, 6.0])
def test_a_train_past_its_stop_stays_degraded(running, overrun_m):
    """It is no arrival: the mode stays DEGRADED at standstill, and the overrun stays reported."""
    stop = running.unit.first.profile.end_m
    running.motion(5.0, stop - 2.0)
    running.motion(1.0, stop + overrun_m)
    running.motion(0.0, stop + overrun_m)
    running(500)
    assert running.unit.mode is Mode.DEGRADED
    assert running.unit.supervisor.state is Supervision.STOP_OVERRUN
    assert running.bus.command["HoldingBrake"]
    assert running.bus.command["EffortDemand"] == SERVICE_BRAKE


def test_a_train_that_seems_to_jump_is_braked_and_its_balises_are_not_counted(running):
    motion = running.bus["ODO_Motion"].values
    motion["Position"] += 200.0
    command = running()
    assert running.unit.supervisor.state is Supervision.ODOMETRY_INVALID
    assert command["EffortDemand"] == SERVICE_BRAKE


def test_a_telegram_from_where_the_train_is_not_is_not_taken(running):
    running.bus["ODO_Balise"].events.append({"Number": 107, "Position": 926.0})
    running()
    running.bus["ODO_Balise"].events.clear()
    assert running.unit.supervisor.state is Supervision.ODOMETRY_INVALID
    running(60)
    assert running.unit.supervisor.state is Supervision.NORMAL  # balise 107 has not been passed


def test_the_reference_position_is_the_schedules_and_the_stop_in_hold(loop):
    driven = loop("cat_linh_la_thanh")
    seen = []

    def note(each):
        seen.append(each.bus.sent.get("ATO_Position", {}).get("ReferencePosition"))

    driven.run(110.0, each=note)
    unit = driven.unit
    table = unit.timetable.table
    at_s = 40.0
    since = at_s - 0.01 - (unit.timetable._zero_ns * 1e-9)
    assert seen[round(at_s / 0.01)] == pytest.approx(table.position_at(since), abs=0.05)
    assert seen[-1] == driven.journey.destination.position_m


@pytest.mark.parametrize("period_s", [0.05, 0.1])
def test_a_period_that_lets_the_command_time_out_is_bad_input(scenario_file, contract, period_s):
    path = scenario_file(f"[controller]\nperiod_s = {period_s}\n")
    with pytest.raises(RailwayDataError) as error:
        build(path, contract)
    assert str(error.value).startswith(f"{path}: controller.period_s: {period_s:g} ")
    assert "ATO_Command" in str(error.value)
    assert "\n" not in str(error.value)
    assert error.value.exit_code == 2
