"""New plans under way: without a step, within limits, on time; the same from a process of its own."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from controller.modes import Mode
from controller.planning import plan, reference_table
from controller.profile import ProfileError
from controller.replanning import Replanner, Request, Start, SynchronousSource, past_s
from controller.replanning_process import ChildSource, packed, unpacked
from controller.supervision import Supervision
from controller.unit import ControllerUnit
from hil.railway import SpeedLimit
from hil.railway.library import find_scenario

NAME = "cat_linh_la_thanh"
RESTRICTION = SpeedLimit(600.0, 700.0, 8.0)


def on_plan(clock_s, end_s, restrictions=(), *, number=1, base=0):
    return Request(number, Start.ON_PLAN, base, clock_s, 0.0, 0.0, 0.0, end_s, restrictions)


@pytest.fixture(scope="module")
def first(journeys, configs):
    return plan(journeys[NAME], configs[NAME])


@pytest.fixture
def replanner(journeys, configs, first):
    return Replanner(journeys[NAME], configs[NAME], first)


def smoothed(replanner, request):
    return replanner.comfort.smoothed(replanner.sharp(request))


@pytest.mark.parametrize("clock_s", [3.0, 8.0, 14.3, 20.0, 27.7, 35.0, 41.9, 48.0])
@pytest.mark.parametrize(("end_s", "restrictions"), [(80.0, ()), (110.0, ()), (88.0, (RESTRICTION,))])
def test_until_it_differs_a_new_plan_is_the_old_one(replanner, first, clock_s, end_s, restrictions):
    """Position, speed, acceleration: so nothing can jump when it is taken."""
    old, new = first.profile, smoothed(replanner, on_plan(clock_s, end_s, restrictions))
    before = new.time_s <= clock_s
    for name, tolerance in (("position_m", 1e-4), ("speed_mps", 1e-4), ("acceleration_mps2", 3e-3)):
        same = np.interp(new.time_s[before], old.time_s, getattr(old, name))
        np.testing.assert_allclose(getattr(new, name)[before], same, atol=tolerance)


@pytest.mark.parametrize("clock_s", np.arange(2.0, 52.0, 3.1))
def test_wherever_it_begins_it_keeps_limits_and_jerk(replanner, journeys, clock_s):
    journey = journeys[NAME]
    for end_s, restrictions in ((80.0, ()), (88.0, (SpeedLimit(600.0, 700.0, 12.5),))):
        new = smoothed(replanner, on_plan(float(clock_s), end_s, restrictions))
        limits = [journey.line.speed_limit_mps(x, journey.train.length_m) for x in new.position_m]
        assert np.min(np.array(limits) - new.speed_mps) >= 0.03
        jerk = np.diff(new.acceleration_mps2) / np.diff(new.time_s)
        assert np.max(np.abs(jerk)) <= 1.05 * journey.train.comfort_jerk_mps3


def test_it_takes_the_time_that_is_left(replanner):
    assert smoothed(replanner, on_plan(20.0, 100.0)).duration_s == pytest.approx(100.0, abs=0.002)
    fastest = smoothed(replanner, on_plan(20.0, 10.0)).duration_s
    assert fastest == pytest.approx(smoothed(replanner, on_plan(20.0, 50.0)).duration_s)


def test_a_restriction_is_kept_by_the_whole_train(replanner, journeys):
    new = smoothed(replanner, on_plan(20.0, 88.0, (RESTRICTION,)))
    inside = (new.position_m >= 600.0) & (new.position_m <= 700.0 + journeys[NAME].train.length_m)
    assert np.max(new.speed_mps[inside]) <= 8.0


@pytest.mark.parametrize(("speed", "acceleration"), [(5.0, -0.8), (10.0, 0.5), (3.0, 0.9), (12.0, 0.0)])
def test_a_plan_for_a_moving_train_begins_as_it_moves(replanner, speed, acceleration):
    request = Request(1, Start.MOVING, 0, 0.0, 400.0, speed, acceleration, 90.0)
    new = smoothed(replanner, request)
    at = past_s(replanner.comfort)
    assert np.interp(at, new.time_s, new.position_m) == pytest.approx(400.0, abs=1e-3)
    assert np.interp(at, new.time_s, new.speed_mps) == pytest.approx(speed, abs=1e-4)
    assert np.interp(at, new.time_s, new.acceleration_mps2) == pytest.approx(acceleration, abs=1e-3)
    after = new.time_s >= at
    jerk = np.diff(new.acceleration_mps2[after]) / np.diff(new.time_s[after])
    assert np.max(np.abs(jerk)) <= 0.72


def test_beyond_its_end_no_plan_goes_on(replanner):
    with pytest.raises(ProfileError):
        replanner.sharp(on_plan(500.0, 600.0))
    assert replanner.solve(on_plan(500.0, 600.0)).columns is None


def test_requests_go_through_the_pipe_unchanged():
    request = on_plan(20.0, 88.0, (RESTRICTION, SpeedLimit(1.0, 2.0, 3.0)), number=7, base=4)
    assert unpacked(packed(request, 1)) == (request, 1)


def test_the_process_answers_as_this_one_does_and_ends_with_its_pipe(journeys, configs, first, replanner):
    table = reference_table(first.profile, journeys[NAME].train, configs[NAME].feed_forward)
    child, here = ChildSource(find_scenario(NAME), table.rows), SynchronousSource(replanner)
    try:
        for request in (
            on_plan(20.0, 88.0, (RESTRICTION,)),
            on_plan(30.0, 110.0, number=2, base=1),
            on_plan(500.0, 600.0, number=3, base=2),
        ):
            assert child.poll(request.number) is None
            for source in (child, here):
                source.post(request)
            deadline = time.monotonic() + 30.0
            while (there := child.poll(request.number)) is None and time.monotonic() < deadline:
                time.sleep(0.002)
            expected = here.poll(request.number)
            if expected.table is None:
                assert there.table is None
                continue
            for x in np.linspace(0.0, 930.0, 200):
                assert there.table.at(float(x), 1e3) == expected.table.at(float(x), 1e3)
    finally:
        child.close()
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)


@pytest.fixture
def held(contract, journeys, configs, first, tools):
    """`held(departure_s)`: the unit against the small train, authorised to depart so late."""

    def make(departure_s, *, time_s=88.0, **true):
        journey = journeys[NAME]
        unit = ControllerUnit(journey, configs[NAME], first, contract)
        unit.timetable._time_ns = round(time_s * 1e9)
        loop = tools.Loop(journey, unit, tools.TestTrain(**true))

        def each(driven):
            allowed = int(driven.cycle * 0.01 >= departure_s)
            driven.bus["ATP_Permission"].values["DepartureAuthorised"] = allowed

        return loop, each

    return make


def test_held_ten_seconds_it_arrives_when_that_is_still_possible(held, replanner):
    """The fastest run from a stand, its brake release included, is what is still possible."""
    loop, each = held(11.0)
    run = loop.run(120.0, each)
    fastest = smoothed(replanner, Request(1, Start.STANDING, 0, 0.0, 0.0, 0.0, 0.0, 1.0)).duration_s + 1.2
    assert loop.unit.timetable.plan_number == 1
    assert run.mode[-1] == Mode.HOLD
    assert run.trip_time_s == pytest.approx(fastest, abs=1.0)
    assert loop.unit.timetable.allowed_s() == pytest.approx(fastest, abs=0.01)
    assert abs(run.stop_error_m) <= 0.02
    assert run.overspeed_mps <= 0.0


def test_departing_on_time_it_keeps_its_plan(held):
    loop, each = held(1.0)
    run = loop.run(120.0, each)
    assert loop.unit.timetable.plan_number == 0
    assert run.trip_time_s == pytest.approx(88.0, abs=1.0)


def restricted(run_loop, at_s, limit=RESTRICTION):
    def each(driven):
        orders = driven.bus["ATP_Restriction"]
        orders.events.clear()
        if driven.cycle == round(at_s / 0.01):
            orders.events.append(
                {
                    "Number": 0,
                    "Start": limit.start_m,
                    "Length": limit.end_m - limit.start_m,
                    "Limit": limit.limit_mps,
                }
            )

    return run_loop.run(150.0, each)


@pytest.mark.parametrize("at_s", [12.0, 22.0, 30.0])
def test_a_restriction_is_kept_and_taken_without_a_jump_in_the_demand(loop, at_s):
    plain, driven = loop(NAME), loop(NAME)
    usual, run = plain.run(120.0), restricted(driven, at_s)
    taken = driven.unit.timetable
    assert taken.plan_number == 1
    inside = (run.position_m >= 600.0) & (run.position_m <= 700.0 + driven.journey.train.length_m)
    assert np.max(run.speed_mps[inside]) <= RESTRICTION.limit_mps
    assert run.mode[-1] == Mode.HOLD
    assert set(run.supervision) == {Supervision.NORMAL}
    assert run.rms_error_mps <= 0.02
    assert run.jerk_mps3 <= 1.0
    assert abs(run.stop_error_m) <= 0.02
    # the plan is taken 0.3 s after the order; demand and reference go on as without it
    around = slice(round(at_s / 0.01), round(at_s / 0.01) + 60)
    np.testing.assert_allclose(run.demand[around], usual.demand[around], atol=2e-3)
    np.testing.assert_allclose(run.reference_mps[around], usual.reference_mps[around], atol=1e-4)
    steps = np.abs(np.diff(run.demand))[round(at_s / 0.01) :]
    assert np.max(steps) <= 1.5 * np.max(np.abs(np.diff(usual.demand[300:])))


def test_after_a_fault_it_replans_and_the_demand_rises_no_faster_than_the_jerk(loop):
    def lose(driven):
        driven.bus["ATP_Permission"].silent = 3000 <= driven.cycle < 3400

    driven = loop(NAME)
    run = driven.run(150.0, each=lose)
    assert driven.unit.timetable.plan_number >= 1
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.05
    assert run.overspeed_mps <= 0.0
    later = run.time_s > 34.6
    steps = np.diff(run.demand[later][run.driving[later]])
    assert np.max(steps) <= 0.05


def test_without_replanning_nothing_is_asked_for(loop, journeys, configs, contract, first, tools):
    config = configs[NAME].model_copy(
        update={"replanning": configs[NAME].replanning.model_copy(update={"enabled": False})}
    )
    driven = tools.Loop(
        journeys[NAME], ControllerUnit(journeys[NAME], config, first, contract), tools.TestTrain()
    )
    run = restricted(driven, 20.0)
    assert driven.unit.timetable.plan_number == 0
    assert run.mode[-1] == Mode.HOLD


class Never:
    """A source that never answers."""

    posted = 0

    def post(self, request):
        self.posted += 1

    def poll(self, number):
        return None

    def work(self):
        pass

    def close(self):
        pass


def test_without_an_answer_the_old_plan_is_driven_to_its_end(journeys, configs, contract, first, tools):
    source = Never()
    unit = ControllerUnit(journeys[NAME], configs[NAME], first, contract, source)
    run = restricted(tools.Loop(journeys[NAME], unit, tools.TestTrain()), 20.0)
    assert source.posted > 3
    assert unit.timetable.plan_number == 0
    assert run.mode[-1] == Mode.HOLD
    assert abs(run.stop_error_m) <= 0.02
