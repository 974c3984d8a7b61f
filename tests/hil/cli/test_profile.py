"""`hil profile` as a user types it: what it prints, what it writes, and what it says when it cannot."""

import csv
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from hil.railway.library import find_line, find_train

CAT_LINH = ("cat_linh_la_thanh", "Cat Linh", "La Thanh")
PNG = b"\x89PNG\r\n"


def hil(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-m", "hil", "profile", *arguments],
        capture_output=True,
        text=True,
        timeout=240,
        cwd=cwd,
        env={**os.environ, "COLUMNS": "100"},
    )


def document(*arguments, cwd):
    done = hil(*arguments, "--json", "--out", str(cwd / "out"), cwd=cwd)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def one_line(done):
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert done.stdout == ""
    return lines[0]


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """The published problem with everything beside it."""
    folder = tmp_path_factory.mktemp("compared")
    return hil(
        *CAT_LINH, "--time", "78", "--compare", "--out", str(folder / "out"), cwd=folder
    ), folder / "out"


def test_the_published_problem_is_the_default(tmp_path):
    found = document(*CAT_LINH, "--time", "78", cwd=tmp_path)
    assert found["energy"]["traction_j"] == pytest.approx(21.7017e6, rel=1e-3)
    assert found["energy"]["net_j"] == found["energy"]["traction_j"]
    assert found["energy"]["regenerated_j"] == 0.0
    assert found["trip_time_s"] == pytest.approx(78.0, abs=0.01)
    assert found["min_time_s"] == pytest.approx(72.9, abs=0.2)
    assert found["solver"] in ("ip", "dp")
    assert found["stages"] > 50
    assert found["solve_time_s"] > 0.0
    assert (found["peak_force_n"], found["peak_power_w"]) == pytest.approx((177e3, 2.68e6), rel=0.02)
    assert "no coasting" not in found["compared"]


@pytest.mark.parametrize("solver", ["ip", "dp"])
def test_the_reverse_journey_runs_against_the_line(tmp_path, solver):
    """The other track's curves differ a little (553 m for 550): 0.3 % of the energy, as measured."""
    found = document("cat_linh_la_thanh", "2", "1", "--time", "83", "--solver", solver, cwd=tmp_path)
    assert (found["from"], found["to"], found["solver"]) == ("La Thanh", "Cat Linh", solver)
    assert found["energy"]["traction_j"] == pytest.approx(17.2740e6, rel=4e-3)


def test_the_tables_name_both_solvers_and_the_plan_without_coasting(compared):
    done, _ = compared
    assert done.returncode == 0, done.stderr
    for text in ("optimal, ip", "optimal, dp", "no coasting", "fastest", "21.6 %", "energy over trip time"):
        assert text in done.stdout
    assert "no coasting  78.000    27.6" in done.stdout


def test_pictures_and_the_table_over_position_are_written(compared):
    _, out = compared
    assert {path.name for path in out.iterdir()} == {"profile.png", "trade_off.png", "profile.csv"}
    for name in ("profile.png", "trade_off.png"):
        assert (out / name).read_bytes().startswith(PNG)
        assert (out / name).stat().st_size > 10_000
    with (out / "profile.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    x, v, t = columns["distance_m"], columns["speed_mps"], columns["time_s"]
    assert (x[0], x[-1], v[0], v[-1]) == (0.0, 931.0, 0.0, 0.0)
    assert t[-1] == pytest.approx(78.0, abs=0.01)
    assert np.sum(2 * np.diff(x) / (v[1:] + v[:-1])) == pytest.approx(78.0, abs=0.01)
    assert columns["net_energy_j"][-1] == pytest.approx(21.7017e6, rel=1e-3)
    work = np.sum(np.maximum(columns["force_n"][:-1], 0.0) * np.diff(x))
    assert work == pytest.approx(columns["net_energy_j"][-1], rel=1e-6)
    assert np.all(v[:-1] <= columns["speed_limit_mps"][:-1] + 1e-6)


def test_the_trade_off_descends_and_passes_through_what_was_asked_for(tmp_path):
    found = document(*CAT_LINH, "--time", "80", "--compare", cwd=tmp_path)
    curve = found["trade_off"]
    times = [point["trip_time_s"] for point in curve]
    energies = [point["net_j"] for point in curve]
    assert np.all(np.diff(times) > 0.0)
    assert np.all(np.diff(energies) < 0.0)
    assert times[0] == pytest.approx(found["min_time_s"])
    assert found["energy"]["net_j"] in energies
    assert set(found["compared"]) == {"ip", "dp", "no coasting", "fastest"} - {found["solver"]}


def test_ttobench_files_by_path_are_a_line_and_a_train(tmp_path):
    shutil.copy(find_line("CN_Songjiazhuang_Yizhuang"), tmp_path / "line.json")
    shutil.copy(find_train("CN_Beijing_Subway"), tmp_path / "train.json")
    limits = ("--max-acceleration", "1", "--max-deceleration", "1")
    words = ("line.json", "2", "3", "--train", "train.json", "--time", "99.917", *limits)  # 1.2 x least time
    found = document(*words, cwd=tmp_path)
    assert found["energy"]["net_j"] / 3.6e6 == pytest.approx(11.391, rel=1e-3)
    energy = found["energy"]
    assert energy["net_j"] == pytest.approx(energy["traction_j"] / 0.7 - 0.8 * energy["regenerated_j"])
    assert energy["braked_j"] == pytest.approx(energy["regenerated_j"])  # no friction brake


def test_efficiencies_of_the_command_line_replace_the_trains(tmp_path):
    words = (*CAT_LINH, "--time", "78", "--traction-efficiency", "0.8", "--regeneration-efficiency", "0.5")
    found = document(*words, cwd=tmp_path)
    energy = found["energy"]
    assert energy["regenerated_j"] > 0.0
    assert energy["net_j"] == pytest.approx(energy["traction_j"] / 0.8 - 0.5 * energy["regenerated_j"])


def test_a_train_with_a_length_needs_longer(tmp_path):
    point = document(*CAT_LINH, "--time", "90", cwd=tmp_path)
    train = document(*CAT_LINH, "--time", "90", "--train-length", "79", cwd=tmp_path)
    assert train["min_time_s"] > point["min_time_s"] + 2.0
    assert train["energy"]["net_j"] > point["energy"]["net_j"]


def test_results_have_a_directory_of_their_own_in_runs(tmp_path):
    done = hil(*CAT_LINH, "--time", "80", "--max-step", "20", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (directory,) = (tmp_path / "runs").iterdir()
    assert directory.name.endswith("-profile-cat_linh_la_thanh-Cat_Linh-La_Thanh")
    assert f"{directory.name}/ (profile.png" in done.stdout


def test_view_records_the_profile_for_the_rerun_viewer(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    done = hil(*CAT_LINH, "--time", "80", "--view", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "run.rrd").read_bytes()[:4] == b"RRF2"
    assert "hil view --web out" in done.stdout or sys.platform != "linux"


def test_too_short_a_time_says_the_least_and_what_binds(tmp_path):
    done = hil(*CAT_LINH, "--time", "70", cwd=tmp_path)
    assert done.returncode == 2
    assert "70 s must be at least 72.9" in (line := one_line(done))
    assert "binds" in line
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("no_such_line", "1", "2", "--time", "80"), "no line 'no_such_line' in the library"),
        (("no_such.json", "1", "2", "--time", "80"), "no_such.json: no such line file"),
        (("cat_linh_la_thanh", "1", "9", "--time", "80"), "no stop '9'; it has 'Cat Linh', 'La Thanh', or"),
        (("cat_linh_la_thanh", "1", "1", "--time", "80"), "FROM and TO are both 'Cat Linh'"),
        (("cat_linh_la_thanh", "1", "2"), "--time is missing"),
        (("cat_linh_la_thanh", "1", "2", "--time", "-3"), "--time -3: must be greater than 0"),
        (("cat_linh_la_thanh", "1", "2", "--time", "nan"), "--time nan: must be greater than 0"),
        (
            ("cat_linh_la_thanh", "1", "2", "--time", "80", "--solver", "magic"),
            "--solver magic: must be one of",
        ),
        (("cat_linh_la_thanh", "1", "2", "--time", "80", "--max-step", "0"), "--max-step 0: must be greater"),
        (
            ("cat_linh_la_thanh", "1", "2", "--time", "80", "--max-acceleration", "-1"),
            "--max-acceleration -1",
        ),
        (
            ("cat_linh_la_thanh", "1", "2", "--time", "80", "--traction-efficiency", "7"),
            "--traction-efficiency 7",
        ),
        (("cat_linh_la_thanh", "1", "2", "--time", "80", "--train", "x"), "no train 'x' in the library"),
        (("CN_Songjiazhuang_Yizhuang", "1", "2", "--time", "200"), "--train must be given"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, words, text):
    done = hil(*words, cwd=tmp_path)
    assert done.returncode == 2
    assert text in one_line(done)
