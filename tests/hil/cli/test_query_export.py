"""hil query and hil export as a user starts them, and what other programs find in the files."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import can
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.cli import main
from hil.node import CYCLE_FIELDS, TimingRing
from hil.record import Recorder, RecorderOptions, open_run

START_NS = 1_790_000_000_123_456_789
EXAMPLE = Path(__file__).parents[3] / "examples" / "ask_a_recording.py"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two seconds: the speed rises to 36 km/h, the reference is 1 km/h above; two rings."""
    folder = tmp_path_factory.mktemp("cli")
    contract = Contract.load()
    frames = []

    def send(at_ns, name, **values):
        codec = contract.message(name)
        data = bytes(codec.encode(values))
        frames.append(Frame(START_NS + at_ns, codec.can_id, data))

    for k in range(200):
        speed_mps = k / 199 * 10.0
        send(
            k * 10_000_000,
            "ODO_Motion",
            Speed=speed_mps,
            Position=0.0,
            Valid=1,
            Standstill=0,
            Slip=0,
            Slide=0,
        )
        if k % 10 == 0:
            send(k * 10_000_000, "ATO_Status", Law=1, Mode=2, Supervision=0, SpeedError=0.0,
                 ReferenceSpeed=speed_mps + 1 / 3.6, ReferenceAcceleration=0.0)  # fmt: skip
    rings = {}
    for name, probes in (("controller", [("integral", "1")]), ("plant_sim", [("speed_mps", "m/s")])):
        rings[name] = TimingRing(
            folder / f"{name}.ring", name=name, period_ns=10_000_000, probes=probes, clock="realtime",
            realtime_offset_ns=START_NS, capacity=1024,
        )  # fmt: skip
    options = RecorderOptions(folder, rings={name: ring.path for name, ring in rings.items()})
    with Recorder(contract, options) as recorder:
        append(rings)
        recorder.feed(frames)
    for ring in rings.values():
        ring.close()
    return folder


def append(rings):
    """200 cycles, the wake-up latency of cycle k being k us."""
    for k in range(200):
        woke = k * 10_000_000 + k * 1000
        stamps = (k, k * 10_000_000, woke, woke + 1000, woke + 2000, woke + 3000, 0)
        for name, ring in rings.items():
            value = k / 199 * 10.0 if name == "plant_sim" else float(k)
            ring.append(*stamps, *[0] * (len(CYCLE_FIELDS) - len(stamps)), value)


def process(*words):
    """The command line as a process of its own, as a user starts it."""
    command = [sys.executable, "-m", "hil", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def hil(*words):
    """The command line in this process: libraries are loaded once, not in every test."""
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as error:
        code = main([str(word) for word in words])
    return subprocess.CompletedProcess(words, code, out.getvalue(), error.getvalue())


def test_query_prints_the_number_with_its_unit(run):
    done = process("query", run, "max(ODO_Motion.Speed)")
    assert (done.returncode, done.stdout, done.stderr) == (0, "36 km/h\n", "")


def test_several_expressions_are_answered_together_and_as_json(run):
    texts = ["max(abs(ODO_Motion.Speed - ATO_Status.ReferenceSpeed))", "count(ODO_Motion.Speed > 18)",
             "first(ODO_Motion.Speed) / 0", "between(plant_sim.speed_mps, 0, 0.05)"]  # fmt: skip
    done = hil("query", run, *texts, "--json")
    answers = json.loads(done.stdout)
    assert list(answers) == texts
    assert answers[texts[0]]["unit"] == "km/h"
    assert answers[texts[0]]["value"] == pytest.approx(1.0, abs=0.7)
    assert answers[texts[1]]["value"] == 100
    assert answers[texts[2]]["value"] is None
    assert len(answers[texts[3]]["values"]) == len(answers[texts[3]]["sim_time_s"]) == 6
    plain = hil("query", run, *texts[:2]).stdout.splitlines()
    assert plain[1] == f"{texts[1]} = 100"


def test_the_list_has_units_and_samples(run):
    listed = {row["name"]: row for row in json.loads(hil("query", run, "--list", "--json").stdout)}
    assert listed["ODO_Motion.Speed"] == {"name": "ODO_Motion.Speed", "unit": "km/h", "samples": 200}
    assert any(
        "plant_sim.speed_mps" in line and "m/s" in line
        for line in hil("query", run, "--list").stdout.splitlines()
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["max(ODO_Motion.Sped)"], "ODO_Motion.Speed"),
        (["max(ODO_Motion.Speed"], "not an expression"),
        (["ODO_Motion.Speed + ODO_Motion.Position"], "not the same kind"),
        ([], "--list"),
    ],
)
def test_a_bad_question_is_one_line_and_exit_code_2(run, words, told, capsys):
    code = main(["query", str(run), *words])
    out, error = capsys.readouterr()
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert told in error


def test_no_recording_is_one_line_and_exit_code_2(tmp_path, capsys):
    for words in (["query", "1"], ["export", "--csv"], ["export", "--asc"], ["export"]):
        assert main([words[0], str(tmp_path), *words[1:]]) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_export_writes_what_other_programs_read(run, tmp_path):
    done = process(
        "export", run, "--csv", "--parquet", "--asc", "--blf", "--log", "--trc", "--out", tmp_path, "--json"
    )
    assert done.returncode == 0, done.stderr
    files = {Path(row["file"]).name: row for row in json.loads(done.stdout)["files"]}
    assert set(files) == {
        "signals.csv",
        "signals.parquet",
        *(f"frames.{k}" for k in ("asc", "blf", "log", "trc")),
    }
    assert {row["frames"] for name, row in files.items() if name.startswith("frames")} == {220}
    wide, text = pq.read_table(tmp_path / "signals.parquet"), pyarrow.csv.read_csv(tmp_path / "signals.csv")
    assert wide.column_names == text.column_names
    assert wide.num_rows == text.num_rows == 200  # the cycle grid
    speed = open_run(run)["plant_sim.speed_mps"].values
    for table in (wide, text):
        np.testing.assert_array_equal(table["plant_sim.speed_mps [m/s]"].to_numpy(), speed)
    with can.LogReader(tmp_path / "frames.asc", relative_timestamp=False) as reader:
        assert abs(next(iter(reader)).timestamp - START_NS / 1e9) < 1e-6


def test_export_makes_a_table_per_message_and_takes_chosen_signals_only(run, tmp_path):
    done = hil("export", run, "--parquet", "--per-message", "--signal", "ODO_Motion.Speed",
               "--signal", "controller/integral", "--out", tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"ODO_Motion.parquet", "controller.parquet"}
    table = pq.read_table(tmp_path / "ODO_Motion.parquet")
    assert table.column_names == ["bus_time", "sim_time", "ODO_Motion.Speed [km/h]"]
    assert table["bus_time"].cast("int64")[0].as_py() == START_NS


def test_export_of_mf4_has_signals_and_frames(run, tmp_path):
    asammdf = pytest.importorskip("asammdf")
    assert hil("export", run, "--mf4", "--out", tmp_path).returncode == 0
    with asammdf.MDF(tmp_path / "signals.mf4") as file:
        speed = file.get("ODO_Motion.Speed")
        assert (speed.unit, len(speed.samples), speed.samples.max()) == ("km/h", 200, 36.0)
    with can.LogReader(tmp_path / "frames.mf4") as reader:
        assert len(list(reader)) == 220


def test_a_frame_log_of_any_tool_can_be_asked_and_converted(run, tmp_path):
    assert hil("export", run, "--log", "--out", tmp_path).returncode == 0
    log = tmp_path / "frames.log"
    assert hil("query", log, "max(ODO_Motion.Speed)").stdout == "36 km/h\n"
    assert hil("export", log, "--blf", "--out", tmp_path / "again").returncode == 0
    with can.LogReader(tmp_path / "again" / "frames.blf") as reader:
        assert len(list(reader)) == 220


def test_the_example_script_runs(run):
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), str(run)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "200 samples, highest 36.00 km/h" in done.stdout
    assert "200 cycles, wake-up latency p99 197 us" in done.stdout
    assert "220 frames, 2 identifiers" in done.stdout
