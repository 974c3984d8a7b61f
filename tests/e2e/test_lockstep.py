"""Lockstep: the same run, always, at any speed, in one process or several."""

import os
import signal
import subprocess
import time
from pathlib import Path

import can
import pytest
import rerun_cli
from e2e_support import children_of, finished_run, wait_for_speed

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


def test_a_channel_whose_hub_is_there_already_is_joined(channel, tmp_path):
    """For example because a logger was started first, and started the hub."""
    with can.Bus(interface="hil", channel=channel) as early:
        done = finished_run(tmp_path / "run", "--lockstep", "-i", "hil", "-c", channel)
        assert done.code == 0, done.stderr
        heard = 0
        while early.recv(0.0) is not None:
            heard += 1
        assert heard == len(done.frames)
