"""Every format keeps what was on the bus: identifier, its 29-bit flag, data, absolute time."""

from __future__ import annotations

import subprocess
import sys
from datetime import UTC, datetime

import can
import numpy as np
import pytest

from hil.canbus.contract import Contract
from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.record import (
    MissingPackage,
    Recorder,
    RecorderOptions,
    RecordError,
    RecordingUnreadable,
    log_formats,
    open_run,
)
from hil.record.blocks import decode_block
from hil.record.log_formats import FRAME_FORMATS, check_formats, convert_log, read_log, write_log
from hil.record.table_files import write_measurement

START_S = 1_790_000_000.056789
"""Its milliseconds have a leading zero: python-can's ASC header drops it."""

MICROSECOND = 1.001e-6


def messages(*, fd=False):
    random = np.random.default_rng(7)
    made = []
    for k in range(400):
        is_fd = fd and k % 3 == 0
        length = int(random.choice([8, 12, 64])) if is_fd else int(random.integers(0, 9))
        made.append(
            can.Message(
                timestamp=START_S + k * 0.00731,
                arbitration_id=int(random.integers(0, 0x800 if k % 2 else 0x2000_0000)),
                is_extended_id=k % 2 == 0,
                data=random.bytes(length),
                is_fd=is_fd,
                bitrate_switch=is_fd and k % 2 == 0,
                channel=k % 2,
                is_rx=True,
            )
        )
    return made


@pytest.mark.parametrize("kind", FRAME_FORMATS)
@pytest.mark.parametrize("fd", [False, True])
def test_a_log_comes_back_whole_from_python_can(kind, fd, tmp_path):
    if kind == "mf4":
        pytest.importorskip("asammdf")
    sent = messages(fd=fd)
    written, left_out = write_log(tmp_path / f"x.{kind}", kind, sent)
    expected = [m for m in sent if not (kind == "trc" and m.is_fd)]
    assert (written, left_out) == (len(expected), len(sent) - len(expected))
    options = {"relative_timestamp": False} if kind == "asc" else {}
    with can.LogReader(tmp_path / f"x.{kind}", **options) as reader:  # python-can, none of our reading
        back = list(reader)
    assert [m.arbitration_id for m in back] == [m.arbitration_id for m in expected]
    assert [m.is_extended_id for m in back] == [m.is_extended_id for m in expected]
    assert [bytes(m.data) for m in back] == [bytes(m.data) for m in expected]
    assert [m.is_fd for m in back] == [m.is_fd for m in expected]
    assert [m.bitrate_switch for m in back] == [m.bitrate_switch for m in expected]
    times = np.array([m.timestamp for m in back]) - [m.timestamp for m in expected]
    assert np.max(np.abs(times)) <= MICROSECOND
    channels = [int(str(m.channel).removeprefix("can")) - (kind == "trc") for m in back]
    assert channels == [m.channel for m in expected]


@pytest.mark.parametrize("kind", FRAME_FORMATS)
def test_our_reading_is_in_absolute_time_for_every_format(kind, tmp_path):
    if kind == "mf4":
        pytest.importorskip("asammdf")
    write_log(tmp_path / f"x.{kind}", kind, messages())
    times = [m.timestamp for m in read_log(tmp_path / f"x.{kind}")]
    assert np.allclose(times, [m.timestamp for m in messages()], rtol=0, atol=MICROSECOND)


def test_an_empty_log_is_a_file_that_can_be_read(tmp_path):
    for kind in ("blf", "asc", "log"):
        assert write_log(tmp_path / f"x.{kind}", kind, []) == (0, 0)
        assert list(read_log(tmp_path / f"x.{kind}")) == []


@pytest.fixture(scope="module")
def recorded(make_run, tmp_path_factory):
    run = make_run(3.0)
    folder = tmp_path_factory.mktemp("logs")
    run.record(folder)
    return run, folder


def test_cantools_decodes_the_candump_log_to_the_recorded_values(recorded, tmp_path):
    run, folder = recorded
    convert_log(folder / "frames.blf", tmp_path, ["log"])
    done = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(run.contract.path)],
        stdin=(tmp_path / "frames.log").open(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    lines = [line for line in done.stdout.splitlines() if "ODO_Motion(" in line]
    speeds = [float(line.split("Speed: ")[1].split(" ")[0]) for line in lines]
    recorded_speeds = open_run(folder)["ODO_Motion.Speed"].values
    assert len(speeds) > 200
    np.testing.assert_allclose(speeds, recorded_speeds, rtol=1e-12)
    first = float(lines[0].partition("(")[2].partition(")")[0])
    sent = next(f for f in run.frames if f.can_id == run.contract.message("ODO_Motion").can_id)
    assert abs(first - sent.timestamp_ns / 1e9) < MICROSECOND


def test_asammdf_reads_the_signals_with_units_names_and_absolute_time(recorded, tmp_path):
    asammdf = pytest.importorskip("asammdf")
    _, folder = recorded
    data = open_run(folder)
    assert write_measurement(data, tmp_path / "signals.mf4") > 60
    with asammdf.MDF(tmp_path / "signals.mf4") as file:
        for name in ("ODO_Motion.Speed", "plant_sim.speed_mps", "controller.wakeup_latency_us"):
            signal, column = file.get(name), data[name]
            np.testing.assert_array_equal(signal.samples, column.values)
            assert signal.unit == column.unit
            stamps = file.header.start_time.timestamp() + signal.timestamps
            assert np.max(np.abs(stamps - column.bus_time_ns / 1e9)) < MICROSECOND
        words = [word.decode() for word in file.get("ATO_Status.Mode").samples]
        assert words == data["ATO_Status.Mode"].names()


def test_asammdf_takes_the_signals_out_of_the_bus_logging(recorded, tmp_path):
    asammdf = pytest.importorskip("asammdf")
    run, folder = recorded
    convert_log(folder / "frames.blf", tmp_path, ["mf4"])
    with asammdf.MDF(tmp_path / "frames.mf4") as file:
        started = datetime.fromtimestamp(run.frames[0].timestamp_ns // 1000 / 1e6, UTC)
        assert abs((file.header.start_time - started).total_seconds()) < 2e-6
        decoded = file.extract_bus_logging({"CAN": [(str(run.contract.path), 0)]})
        speed = decoded.select(["Speed"])[0]
    np.testing.assert_allclose(speed.samples, open_run(folder)["ODO_Motion.Speed"].values, rtol=1e-12)


def test_the_recorder_writes_more_formats_when_asked(make_run, tmp_path):
    run = make_run(1.0)
    with Recorder(run.contract, RecorderOptions(tmp_path, logs=("asc", "log", "blf"))) as recorder:
        run.play(recorder, {})
    for kind in ("blf", "asc", "log"):
        assert [m.arbitration_id for m in read_log(tmp_path / f"frames.{kind}")] == [
            f.can_id for f in run.frames
        ]


def test_a_29_bit_identifier_stays_one_from_the_bus_to_every_log(tmp_path):
    extended = 0x100 | EXTENDED_ID_FLAG
    frames = [
        Frame(int(START_S * 1e9), extended, b"\x01"),
        Frame(int(START_S * 1e9) + 1000, 0x7FF, b"\x02" * 12),
    ]
    with Recorder(Contract.load(), RecorderOptions(tmp_path, logs=("asc", "log"))) as recorder:
        recorder.feed(frames)
    for kind in ("blf", "asc", "log"):
        back = list(read_log(tmp_path / f"frames.{kind}"))
        assert [(m.arbitration_id, m.is_extended_id, m.is_fd) for m in back] == [
            (0x100, True, False),
            (0x7FF, False, True),
        ]


def test_a_29_bit_identifier_is_not_decoded_as_the_11_bit_one_of_the_same_number(contract):
    codec = contract.message("ODO_Motion")
    data = bytes(codec.length)
    block = decode_block(
        [Frame(1, codec.can_id, data), Frame(2, codec.can_id | EXTENDED_ID_FLAG, data)], contract
    )
    assert len(block.messages["ODO_Motion"].rows) == 1
    assert dict(block.unknown) == {codec.can_id | EXTENDED_ID_FLAG: 1}


def test_unknown_formats_and_missing_packages_are_told_in_one_line(monkeypatch):
    assert check_formats(["asc", "asc", "blf"]) == ("asc", "blf")
    with pytest.raises(RecordError, match="--log xyz"):
        check_formats(["xyz"])
    monkeypatch.setattr(log_formats, "find_spec", lambda name: None)
    with pytest.raises(MissingPackage, match="asammdf"):
        check_formats(["mf4"])


def test_a_file_that_is_no_log_is_an_error_of_one_line(tmp_path):
    (tmp_path / "x.blf").write_bytes(b"no log at all, but long enough to be looked at by a reader")
    with pytest.raises(RecordingUnreadable, match="not a readable frame log"):
        list(read_log(tmp_path / "x.blf"))
    with pytest.raises(RecordingUnreadable, match="no such frame log"):
        list(read_log(tmp_path / "nothing.blf"))
