"""Odometer and balise reader: errors are as configured, and corrected where they should be."""

from __future__ import annotations

import numpy as np
import pytest

from hil.railway import Balise
from plant_sim.config import OdometryTable
from plant_sim.odometry import Odometry

BALISES = (Balise(2, 200.0), Balise(1, 100.0), Balise(3, 300.0))
EXACT = {"wheel_diameter_error": 0.0, "balise_error_m": 0.0}


def ride(
    odometry: Odometry, start_m: float, end_m: float, step_m: float = 0.15, **flags: bool
) -> list[Balise]:
    """Go from start to end at a steady speed in cycles of 10 ms; balises read on the way."""
    read: list[Balise] = []
    steps = round(abs(end_m - start_m) / step_m)
    places = np.linspace(start_m, end_m, steps + 1)[1:]
    speed_mps = (end_m - start_m) / steps / 0.01
    for place in places:
        odometry.update(
            float(place), speed_mps, 0.01, slips=flags.get("slips", False), slides=flags.get("slides", False)
        )
        read += odometry.passed
    return read


def test_perfect_odometer_measures_the_truth() -> None:
    odometry = Odometry(OdometryTable(**EXACT), BALISES, 0.0, 1)
    ride(odometry, 0.0, 250.0)
    assert odometry.error_m == pytest.approx(0.0, abs=1e-9)


def test_wrong_wheel_diameter_biases_speed_and_distance_alike() -> None:
    odometry = Odometry(OdometryTable(wheel_diameter_error=0.01), (), 0.0, 1)
    ride(odometry, 0.0, 500.0)
    assert odometry.position_m == pytest.approx(505.0, rel=1e-9)
    assert odometry.speed_mps == pytest.approx(1.01 * 500.0 / round(500.0 / 0.15) / 0.01)


def test_balise_resets_the_accumulated_error() -> None:
    odometry = Odometry(OdometryTable(wheel_diameter_error=0.01, balise_error_m=0.0), BALISES, 0.0, 1)
    ride(odometry, 0.0, 99.9)
    assert odometry.error_m == pytest.approx(0.999, abs=1e-6)
    ride(odometry, 99.9, 101.0)
    assert odometry.error_m == pytest.approx(0.01, abs=1e-6)


def test_each_balise_is_read_once_and_in_order() -> None:
    read = ride(Odometry(OdometryTable(), BALISES, 0.0, 1), 0.0, 400.0)
    assert [balise.number for balise in read] == [1, 2, 3]


def test_rolling_back_reads_the_balise_again() -> None:
    odometry = Odometry(OdometryTable(**EXACT), BALISES, 150.0, 1)
    assert [b.number for b in ride(odometry, 150.0, 250.0)] == [2]
    assert [b.number for b in ride(odometry, 250.0, 150.0)] == [2]
    assert odometry.error_m == pytest.approx(0.0, abs=1e-9)


def test_balise_reached_exactly_at_the_end_of_a_cycle_is_read_in_that_cycle_and_not_again() -> None:
    odometry = Odometry(OdometryTable(**EXACT), BALISES, 99.0, 1)
    odometry.update(100.0, 100.0, 0.01, slips=False, slides=False)
    assert [balise.number for balise in odometry.passed] == [1]
    odometry.update(101.0, 100.0, 0.01, slips=False, slides=False)
    assert odometry.passed == ()


def test_balises_passed_in_one_cycle_are_all_read() -> None:
    odometry = Odometry(OdometryTable(**EXACT), BALISES, 0.0, 1)
    odometry.update(350.0, 20.0, 17.5, slips=False, slides=False)
    assert [balise.number for balise in odometry.passed] == [1, 2, 3]


def test_missed_balises_are_as_frequent_as_configured() -> None:
    many = tuple(Balise(number, float(number)) for number in range(1, 2001))
    read = ride(Odometry(OdometryTable(missed_balise_probability=0.25), many, 0.0, 7), 0.0, 2001.0, 0.5)
    assert 1400 < len(read) < 1600


def test_same_seed_same_measurement_other_seed_another() -> None:
    table = OdometryTable(speed_noise_mps=0.01, missed_balise_probability=0.3)

    def measured(seed: int) -> tuple[float, float]:
        odometry = Odometry(table, BALISES, 0.0, seed)
        ride(odometry, 0.0, 350.0)
        return odometry.position_m, odometry.speed_mps

    assert measured(3) == measured(3)
    assert measured(3) != measured(4)


def test_speed_noise_has_the_configured_deviation_and_no_bias() -> None:
    odometry = Odometry(OdometryTable(speed_noise_mps=0.005, wheel_diameter_error=0.0), (), 0.0, 1)
    speeds = []
    for cycle in range(1, 5001):
        odometry.update(0.1 * cycle, 10.0, 0.01, slips=False, slides=False)
        speeds.append(odometry.speed_mps)
    assert np.std(speeds) == pytest.approx(0.005, rel=0.05)
    assert np.mean(speeds) == pytest.approx(10.0, abs=4 * 0.005 / 5000**0.5)


def test_noise_does_not_hide_standstill() -> None:
    odometry = Odometry(OdometryTable(speed_noise_mps=0.5), (), 10.0, 1)
    odometry.update(10.0, 0.0, 0.01, slips=False, slides=False)
    assert odometry.standstill
    assert odometry.speed_mps == 0.0


def test_slipping_wheel_reads_too_fast_and_recovers() -> None:
    odometry = Odometry(OdometryTable(**EXACT), (), 0.0, 1)
    ride(odometry, 0.0, 50.0, slips=True)
    assert odometry.speed_mps == pytest.approx(1.1 * 15.0, rel=0.01)
    ride(odometry, 50.0, 200.0)
    assert odometry.speed_mps == pytest.approx(15.0, rel=1e-3)
    assert odometry.error_m > 3.0


def test_sliding_wheel_reads_too_slow() -> None:
    odometry = Odometry(OdometryTable(**EXACT), (), 0.0, 1)
    ride(odometry, 0.0, 50.0, slides=True)
    assert odometry.speed_mps == pytest.approx(0.9 * 15.0, rel=0.01)
