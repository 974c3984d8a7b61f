from dataclasses import replace
from xml.etree import ElementTree

import pytest

from hil.bench.junit import write_junit
from hil.bench.metrics import ControlMetrics
from hil.bench.scenario import Limits
from hil.bench.verdict import Counters, criteria, verdict

GOOD = ControlMetrics(0.01, 0.05, -0.5, 0.02, 0.7, 0.1, 90.5, 2e7, 1e6)
CLEAN = Counters({"controller": 1}, {"controller": 1}, 0, 0)


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
    "counters",
    [
        Counters({"controller": 4}, {"controller": 1}, 0, 0),
        Counters({"controller": 2}, {"controller": 2}, 0, 0),
        Counters({"controller": 0}, {"controller": 0}, 1, 0),
        Counters({"controller": 0}, {"controller": 0}, 0, 1),
    ],
)
def test_misses_losses_and_rejections_fail_the_run(counters):
    assert judge(counters=counters)[0] == "failed"


def test_deadlines_are_not_judged_in_lockstep():
    late = Counters({"controller": 99}, {"controller": 9}, 0, 0)
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
