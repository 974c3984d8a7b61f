"""Lockstep: the same run, always, at any speed, in one process or several."""

import os
import signal
import subprocess
import time
from pathlib import Path

import can
import pytest
import rerun_cli
from e2e_support import HIL, children_of, finished_run, wait_for_speed

from hil.record import open_run

VERIFY = str(Path(rerun_cli.__file__).parent / "rerun")


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    out = tmp_path_factory.mktemp("lockstep") / "first"
    return finished_run(out, "--lockstep", "-i", "hil", "-c", f"first-{os.getpid()}")


def test_default_scenario_passes_and_leaves_everything_on_disk(first):
    assert first.code == 0, first.stdout + first.stderr
    assert first.summary["verdict"] == "passed"
    for name in ("run.rrd", "frames.blf", "summary.json", "junit.xml", "scenario.toml"):
        assert (first.out / name).stat().st_size > 0, name
    subprocess.run([VERIFY, "rrd", "verify", str(first.out / "run.rrd")], check=True, capture_output=True)


def test_same_seed_gives_identical_frames(first, run_hil):
    second = run_hil("--lockstep", name="second")
    assert len(first.frames) > 10_000
    assert second.frames == first.frames


def test_one_process_gives_the_frames_of_separate_processes(first, run_hil):
    one = run_hil("--lockstep", "-i", "virtual", "-c", "one", name="one", bus=False)
    assert one.code == 0, one.stdout + one.stderr
    assert one.summary["processes"] == "one"
    assert one.frames == first.frames


def test_another_seed_gives_other_frames_when_the_odometer_is_noisy(run_hil):
    noisy = ["--lockstep", "--set", "plant.odometry.speed_noise_mps=0.005"]
    a = run_hil(*noisy, "--seed", "1", "-i", "virtual", "-c", "a", name="a", bus=False)
    b = run_hil(*noisy, "--seed", "2", "-i", "virtual", "-c", "b", name="b", bus=False)
    assert a.frames != b.frames


def test_faster_than_real_time_and_says_by_how_much(first):
    # Wide on purpose: other programs share the machine. The measured figures are in the benchmarks.
    assert first.summary["speedup"] > 3


@pytest.mark.parametrize("victim", ["controller", "plant_sim"])
def test_a_process_paused_for_two_seconds_changes_nothing(first, start_hil, victim):
    process, out, channel = start_hil("--lockstep")
    wait_for_speed(channel, 6.0)
    pid = children_of(process.pid)[victim]
    os.kill(pid, signal.SIGSTOP)
    time.sleep(2.0)
    os.kill(pid, signal.SIGCONT)
    stdout, stderr = process.communicate(timeout=200)
    assert process.returncode == 0, stdout + stderr
    paused = type(first)(0, stdout, stderr, out)
    assert paused.summary["wall_time_s"] > 2.0
    assert paused.frames == first.frames


def test_a_killed_node_ends_the_run_with_one_line_that_names_it(start_hil):
    process, out, channel = start_hil("--lockstep")
    wait_for_speed(channel, 6.0)
    os.kill(children_of(process.pid)["controller"], signal.SIGKILL)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "controller: killed by signal 9" in stderr
    assert len(stderr.strip().splitlines()) == 1
    assert (out / "summary.json").exists()
    _, speed = open_run(out).signal("ODO_Motion.Speed")
    assert speed.max() > 20.0
    assert abs(speed[-1]) < 0.1  # the plant brakes by itself


def test_a_channel_whose_hub_is_there_already_is_joined(channel, tmp_path):
    """For example because a logger was started first, and started the hub."""
    with can.Bus(interface="hil", channel=channel) as early:
        done = finished_run(tmp_path / "run", "--lockstep", "-i", "hil", "-c", channel)
        assert done.code == 0, done.stderr
        heard = 0
        while early.recv(0.0) is not None:
            heard += 1
        assert heard == len(done.frames)


@pytest.mark.parametrize("where", ["separate", "one"])
def test_ctrl_c_brakes_the_train_to_a_stand(start_hil, tmp_path, where):
    if where == "separate":
        process, out, channel = start_hil("--lockstep", "mainline_36km")
        wait_for_speed(channel, 6.0)
    else:
        out = tmp_path / "one"
        process = subprocess.Popen(
            [*HIL, "run", "mainline_36km", "--lockstep", "-i", "virtual", "-c", "one", "--out", str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        while not (out / "run.rrd").exists():
            time.sleep(0.1)
        time.sleep(4.0)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=100)
    assert process.returncode == 1, stdout + stderr
    assert "Traceback" not in stderr
    _, speed = open_run(out).signal("ODO_Motion.Speed")
    assert speed.max() > 20.0
    assert abs(speed[-1]) < 0.1


def test_two_runs_started_together_on_the_default_bus_do_not_meet(tmp_path, first):
    runs = [
        subprocess.Popen(
            [*HIL, "run", "--lockstep", "--out", str(tmp_path / name)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "CAN_INTERFACE": "hil", "CAN_CHANNEL": f"both-{os.getpid()}"},
        )
        for name in ("a", "b")
    ]
    for name, process in zip(("a", "b"), runs, strict=True):
        stdout, stderr = process.communicate(timeout=200)
        assert process.returncode == 0, stdout + stderr
        assert type(first)(0, stdout, stderr, tmp_path / name).frames == first.frames


def test_2_km_line_of_the_paper_passes_with_both_laws(tmp_path):
    for law in ("fuzzy_d", "pid"):
        out = tmp_path / law
        done = finished_run(out, "fuzzy_d_2km", "--lockstep", "--law", law, "-i", "virtual", "-c", law)
        assert done.code == 0, done.stdout + done.stderr
        assert abs(done.criterion("stop_error")["value"]) <= 0.05


def test_unequal_periods_give_the_same_frames_in_one_process_and_in_several(tmp_path, channel):
    slow = ["--lockstep", "--set", "controller.period_s=0.02"]
    one = finished_run(tmp_path / "one", *slow, "-i", "virtual", "-c", "x")
    several = finished_run(tmp_path / "several", *slow, "-i", "hil", "-c", channel)
    assert one.summary["ended"] == several.summary["ended"] == "arrived"
    assert one.frames == several.frames
