from dataclasses import replace
from xml.etree import ElementTree

import pytest

from hil.bench.junit import write_junit
from hil.bench.metrics import ControlMetrics
from hil.bench.scenario import Limits
from hil.bench.verdict import Counters, criteria, verdict

GOOD = ControlMetrics(0.01, 0.05, -0.5, 0.02, 0.7, 0.1, 90.5, 2e7, 1e6)
CLEAN = Counters(
    deadline_misses={"controller": 1},
    consecutive_misses={"controller": 1},
    frames_lost=0,
    e2e_rejected=0,
    cycles_not_recorded=0,
    interventions=0,
)


def judge(metrics=GOOD, counters=CLEAN, *, real_time=True, ended="arrived"):
    rows = criteria(metrics, counters, Limits(), timetable_s=90.0, real_time=real_time)
    return verdict(rows, ended=ended), {row.name: row for row in rows}


def test_a_good_run_passes():
    assert judge()[0] == "passed"


@pytest.mark.parametrize(
    ("change", "criterion"),
    [
        ({"stop_error_m": -0.31}, "stop_error"),
        ({"rms_speed_error_mps": 0.06}, "rms_speed_error"),
        ({"max_overspeed_mps": 0.4}, "overspeed"),
        ({"max_jerk_mps3": 1.1}, "jerk"),
        ({"trip_time_s": 92.1}, "trip_time_error"),
        ({"stop_error_m": None}, "stop_error"),
    ],
)
def test_one_value_past_its_limit_fails_the_run_and_only_that_criterion(change, criterion):
    result, rows = judge(replace(GOOD, **change))
    assert result == "failed"
    assert [name for name, row in rows.items() if not row.passed] == [criterion]


@pytest.mark.parametrize(
    ("change", "criterion"),
    [
        ({"deadline_misses": {"controller": 4}}, "deadline_misses_controller"),
        ({"consecutive_misses": {"controller": 2}}, "consecutive_misses_controller"),
        ({"frames_lost": 1}, "frames_lost"),
        ({"e2e_rejected": 1}, "e2e_rejected"),
        ({"cycles_not_recorded": 1}, "cycles_not_recorded"),
        ({"interventions": 1}, "interventions"),
        ({"frames_lost": None}, "frames_lost"),
        ({"deadline_misses": {"controller": None}}, "deadline_misses_controller"),
    ],
)
def test_misses_losses_interventions_and_what_is_not_known_fail_the_run(change, criterion):
    result, rows = judge(counters=replace(CLEAN, **change))
    assert result == "failed"
    assert [name for name, row in rows.items() if not row.passed] == [criterion]


def test_deadlines_are_not_judged_in_lockstep():
    late = replace(CLEAN, deadline_misses={"controller": 99}, consecutive_misses={"controller": 9})
    assert judge(counters=late, real_time=False)[0] == "passed"


@pytest.mark.parametrize(
    ("ended", "expected"), [("aborted", "aborted"), ("died", "failed"), ("timeout", "failed")]
)
def test_only_an_arrival_can_pass(ended, expected):
    assert judge(ended=ended)[0] == expected


def test_junit_counts_and_names_what_failed(tmp_path):
    _, rows = judge(replace(GOOD, stop_error_m=0.5))
    summary = {
        "scenario": "s",
        "verdict": "failed",
        "ended": "arrived",
        "ended_because": "the train holds at its stop",
        "wall_time_s": 1.0,
        "started": "2026-01-01T00:00:00.000+00:00",
        "criteria": [row.as_dict() for row in rows.values()],
    }
    write_junit(summary, tmp_path / "junit.xml")
    suite = ElementTree.parse(tmp_path / "junit.xml").getroot()
    assert suite.get("failures") == "1"
    assert int(suite.get("tests")) == len(rows) + 1
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["stop_error"]
