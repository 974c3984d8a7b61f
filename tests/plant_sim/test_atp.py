"""Protection: never permits more than any limit under the train, never lets it leave with open doors."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.railway import Journey, Line, Stop, Train, load_line, load_train
from hil.railway.library import find_line, find_train
from plant_sim.atp import READY, Protection, restriction_message
from plant_sim.config import AtpTable, RestrictionTable

LINE = load_line(find_line("fuzzy_d_2km"))
TRAIN = load_train(find_train("urban_4car_80m"))
JOURNEY = Journey(LINE, TRAIN, LINE.stops[0], LINE.stops[1], 200.0)
CAT_LINH = load_line(find_line("cat_linh_la_thanh"))
CAT_LINH_JOURNEY = Journey(
    CAT_LINH, load_train(find_train("cat_linh_4car")), CAT_LINH.stops[0], CAT_LINH.stops[1], 100.0
)


@given(st.floats(-50.0, 2100.0))
def test_permitted_speed_is_never_above_a_limit_under_any_part_of_the_train(front_m: float) -> None:
    protection = Protection(JOURNEY, AtpTable(), TRAIN.length_m)
    permitted = protection.permitted_mps(front_m)
    for part_m in np.linspace(front_m - TRAIN.length_m, front_m, 161):
        if LINE.start_m <= part_m <= LINE.end_m:
            assert permitted <= LINE.speed_limit_mps(part_m) + 1e-12


@pytest.mark.parametrize("journey", [JOURNEY, CAT_LINH_JOURNEY])
def test_permitted_speed_can_be_followed_with_the_braking_it_is_made_for(journey: Journey) -> None:
    table = AtpTable()
    protection = Protection(journey, table, journey.train.length_m)
    braking = table.braking_factor * journey.train.max_braking_mps2
    places = np.arange(journey.origin.position_m, journey.destination.position_m + 12.0, 0.05)
    squares = np.array([protection.permitted_mps(x) ** 2 for x in places])
    assert np.min(np.diff(squares)) >= -2.0 * braking * 0.05 - 1e-9
    assert squares[-1] == 0.0


def test_permitted_speed_before_a_lower_limit_is_the_braking_curve() -> None:
    protection = Protection(JOURNEY, AtpTable(braking_factor=1.0), TRAIN.length_m)
    assert protection.permitted_mps(960.0) == pytest.approx(sqrt(10.5**2 + 2 * 1.3 * 40.0))
    assert protection.permitted_mps(1579.9) == pytest.approx(10.5)
    assert protection.permitted_mps(1580.1) == pytest.approx(15.0)


def test_early_break_misses_no_limit() -> None:
    """Against the plain minimum over everything ahead."""
    table = AtpTable()
    protection = Protection(CAT_LINH_JOURNEY, table, CAT_LINH_JOURNEY.train.length_m)
    edges, limits = CAT_LINH.speed_limit_profile(CAT_LINH_JOURNEY.train.length_m)
    braking = table.braking_factor * CAT_LINH_JOURNEY.train.max_braking_mps2
    for front_m in np.arange(0.0, 940.0, 0.7):
        here = limits[np.searchsorted(edges, front_m, side="right") - 1]
        candidates = [here**2, max(0.0, 2 * braking * (931.0 + table.overlap_m - front_m))]
        candidates += [
            v**2 + 2 * braking * (x - front_m) for x, v in zip(edges, limits, strict=False) if x > front_m
        ]
        assert protection.permitted_mps(front_m) == pytest.approx(sqrt(min(candidates)))


def test_target_is_the_next_lower_limit_then_the_stop() -> None:
    protection = Protection(JOURNEY, AtpTable(), TRAIN.length_m)
    assert protection.target(400.0) == pytest.approx((10.5, 600.0))
    assert protection.target(1200.0) == pytest.approx((0.0, 800.0))
    assert protection.target(1990.0) == pytest.approx((0.0, 10.0))
    assert protection.target(2005.0) == (0.0, 0.0)


@given(
    doors_close_s=st.floats(0.0, 20.0),
    delay_s=st.floats(0.0, 20.0),
    ready_s=st.floats(0.0, 20.0),
)
def test_departure_is_never_authorised_with_doors_open(
    doors_close_s: float, delay_s: float, ready_s: float
) -> None:
    table = AtpTable(doors_close_s=doors_close_s, departure_delay_s=delay_s)
    protection = Protection(JOURNEY, table, TRAIN.length_m)
    for time_s in np.arange(0.0, 45.0, 0.25):
        protection.update(float(time_s), 0.0, 0.0, READY if time_s >= ready_s else 0)
        assert protection.doors_closed or not protection.departure_authorised
        if protection.departure_authorised:
            assert time_s >= ready_s + delay_s - 1e-9
    assert protection.departure_authorised


def test_departure_waits_for_ready() -> None:
    protection = Protection(JOURNEY, AtpTable(doors_close_s=0.0, departure_delay_s=0.0), TRAIN.length_m)
    protection.update(100.0, 0.0, 0.0, 0)
    assert not protection.departure_authorised


def test_departure_stays_authorised_while_the_train_runs() -> None:
    protection = Protection(JOURNEY, AtpTable(), TRAIN.length_m)
    for time_s, mode in ((1.0, READY), (3.0, READY), (4.0, 2), (60.0, 3), (90.0, 4)):
        protection.update(time_s, 0.0, 0.0, mode)
    assert protection.departure_authorised


def test_emergency_stop_is_ordered_beyond_the_margin_and_until_standstill() -> None:
    protection = Protection(JOURNEY, AtpTable(emergency_margin_mps=1.0), TRAIN.length_m)
    speeds = (15.9, 16.1, 14.0, 0.01, 0.0)
    ordered = []
    for speed_mps in speeds:
        protection.update(10.0, 600.0, speed_mps, 2)
        ordered.append(protection.emergency_stop)
    assert ordered == [False, True, True, True, False]


def test_rolling_back_too_fast_is_stopped_too(level: Line, urban: Train) -> None:
    journey = Journey(
        Line(name="slow", start_m=-100.0, end_m=500.0, default_limit_mps=3.0),
        urban, Stop("a", 0.0), Stop("b", 400.0), 200.0,
    )  # fmt: skip
    protection = Protection(journey, AtpTable(emergency_margin_mps=0.5), 80.0)
    protection.update(1.0, 100.0, -4.0, 2)
    assert protection.emergency_stop


def restricted(**changes: float) -> Protection:
    table = {"start_m": 600.0, "end_m": 700.0, "limit_kmh": 30.0, "from_s": 5.0} | changes
    return Protection(JOURNEY, AtpTable(restrictions=(RestrictionTable(**table),)), TRAIN.length_m)


def test_a_restriction_counts_from_its_announcement_on_until_the_rear_has_left_it() -> None:
    protection = restricted()
    protection.update(4.99, 650.0, 0.0, READY)
    assert protection.permitted_speed_mps == pytest.approx(15.0)
    protection.update(5.0, 650.0, 0.0, READY)
    assert protection.permitted_speed_mps == pytest.approx(30.0 / 3.6)
    for front_m, limit_mps in ((700.0 + TRAIN.length_m - 0.1, 30.0 / 3.6), (700.1 + TRAIN.length_m, 15.0)):
        protection.update(6.0, front_m, 0.0, READY)
        assert protection.permitted_speed_mps == pytest.approx(limit_mps)


def test_before_a_restriction_the_braking_curve_holds_and_it_is_the_target() -> None:
    protection = restricted()
    protection.update(5.0, 570.0, 0.0, READY)
    braking = AtpTable().braking_factor * TRAIN.max_braking_mps2
    assert protection.permitted_speed_mps == pytest.approx(sqrt((30.0 / 3.6) ** 2 + 2.0 * braking * 30.0))
    assert (protection.target_speed_mps, protection.target_distance_m) == pytest.approx((30.0 / 3.6, 30.0))


def test_a_restriction_is_told_at_once_and_every_second() -> None:
    protection = restricted()
    told = []
    for tick in range(900):
        protection.update(tick * 0.01, 0.0, 0.0, READY)
        told += [tick] * len(protection.announcements)
    assert told == [500, 600, 700, 800]


@given(st.floats(-1000.0, 30_000.0), st.floats(0.1, 30_000.0), st.floats(5.0, 255.0))
def test_what_is_told_is_at_least_the_section_and_at_most_the_limit(
    start_m: float, length_m: float, limit_kmh: float
) -> None:
    table = RestrictionTable(start_m=start_m, end_m=start_m + length_m, limit_kmh=limit_kmh)
    told = restriction_message(3, table)
    assert told["Number"] == 3
    assert told["Start"] <= start_m + 1e-6
    assert told["Start"] + told["Length"] >= table.end_m - 1e-6
    assert told["Limit"] <= limit_kmh / 3.6 + 1e-9
    assert told["Limit"] >= (limit_kmh - 1.001) / 3.6


def test_a_restriction_that_ends_before_it_begins_is_an_error() -> None:
    with pytest.raises(ValueError, match="must be greater than start_m"):
        RestrictionTable(start_m=10.0, end_m=10.0, limit_kmh=30.0)
