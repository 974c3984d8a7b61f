"""Re-planning in whole runs: held at departure, and restricted under way; the same frames every time."""

import pytest

from hil.record import open_run

HELD = ["--set", "journey.time_s=90", "--set", "plant.atp.departure_delay_s=11"]
RESTRICTED = ["--set", "plant.atp.restrictions=[{start_m=600.0, end_m=700.0, limit_kmh=30.0, from_s=25.0}]"]
FASTEST_S = 87.23  # of the comfortable plan, brake release included; see the timetable of the scenario


def plan_number(out):
    return open_run(out).probe("controller", "plan_number")[1]


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    from e2e_support import finished_run

    out = tmp_path_factory.mktemp("replanning") / "held"
    return finished_run(out, "--lockstep", "-i", "virtual", "-c", "held", *HELD)


def test_held_ten_seconds_it_arrives_within_a_second_of_what_is_possible(held):
    assert held.code == 0, held.stdout + held.stderr
    control = held.summary["control"]
    assert abs(control["trip_time_s"] - FASTEST_S) <= 1.0
    assert control["timetable_s"] == 90.0
    assert control["allowed_time_s"] == pytest.approx(FASTEST_S, abs=0.05)
    assert abs(control["trip_time_error_s"]) <= 1.0
    assert plan_number(held.out)[-1] == 1


def test_separate_processes_and_one_process_replan_to_the_same_frames(held, run_hil):
    separate = run_hil("--lockstep", *HELD, name="separate")
    assert separate.code == 0, separate.stdout + separate.stderr
    assert separate.frames == held.frames


def test_a_restriction_over_the_bus_is_kept_and_judged_by_what_it_allows(run_hil):
    run = run_hil("--lockstep", "-i", "virtual", "-c", "slow", *RESTRICTED, name="slow", bus=False)
    assert run.code == 0, run.stdout + run.stderr
    recorded = open_run(run.out)
    position, speed = (
        recorded.probe("plant_sim", "position_m")[1],
        recorded.probe("plant_sim", "speed_mps")[1],
    )
    inside = (position >= 600.0) & (position <= 779.0)
    assert speed[inside].max() <= 30.0 / 3.6
    control = run.summary["control"]
    assert control["allowed_time_s"] > control["timetable_s"] + 5.0
    assert abs(control["trip_time_error_s"]) <= 1.0
    assert control["max_overspeed_mps"] <= 0.0
