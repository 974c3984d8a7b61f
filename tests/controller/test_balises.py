from __future__ import annotations

from controller.balises import BaliseWatch
from hil.railway import Balise

LINE = [Balise(1, -10.0), Balise(11, 100.0), Balise(12, 200.0), Balise(13, 300.0)]


def watch() -> BaliseWatch:
    return BaliseWatch(LINE, start_m=0.0, tolerance_m=15.0)


def test_reading_every_balise_misses_none():
    seen = watch()
    for position in range(0, 400, 5):
        for balise in LINE:
            if position == balise.position_m:
                seen.read(balise.number)
        seen.passed(float(position))
        assert not seen.missed


def test_a_balise_is_missed_behind_its_tolerance():
    seen = watch()
    seen.passed(114.0)
    assert not seen.missed
    seen.passed(116.0)
    assert seen.missed


def test_the_next_telegram_makes_good():
    seen = watch()
    seen.passed(116.0)
    seen.read(12)
    assert not seen.missed
    seen.passed(240.0)
    assert not seen.missed


def test_a_late_telegram_of_the_same_balise_makes_good():
    seen = watch()
    seen.passed(116.0)
    seen.read(11)
    assert not seen.missed


def test_balises_behind_the_start_are_not_expected():
    seen = BaliseWatch(LINE, start_m=250.0, tolerance_m=15.0)
    seen.passed(280.0)
    assert not seen.missed


def test_a_telegram_of_an_unknown_balise_changes_nothing():
    seen = watch()
    seen.passed(116.0)
    seen.read(99)
    assert seen.missed
