"""Frames and cycles go in, run.rrd and frames.blf come out: nothing is lost or changed on the way."""

from __future__ import annotations

import json
import subprocess

import can
import cantools
import numpy as np
import pytest

import dbc
from hil.canbus.frame import Frame
from hil.record import Recorder, RecorderOptions, RecordError, open_run
from hil.record.viewer import viewer_binary

NS_PER_S = 1e9


@pytest.fixture(scope="module")
def recorded(make_run, tmp_path_factory):
    """(synthetic run, its recording, what the recorder counted), 8 s in real time."""
    run = make_run(8.0)
    properties = {"name": "test", "law": "pid", "nested": {"numbers": [1, 2.5]}}
    return run, *run.record(tmp_path_factory.mktemp("realtime"), properties=properties)


@pytest.fixture(scope="module")
def lockstep(make_run, tmp_path_factory):
    run = make_run(4.0, clock="lockstep")
    return run, *run.record(tmp_path_factory.mktemp("lockstep"))


def payloads(run, name):
    codec = run.contract.message(name)
    return [frame for frame in run.frames if frame.can_id == codec.can_id]


def test_every_signal_comes_back_exactly_as_it_was_sent(recorded):
    run, read, _ = recorded
    database = cantools.database.load_file(dbc.path())
    checked = 0
    for name, codec in run.contract.messages.items():
        frames = payloads(run, name)
        for signal in codec.signals:
            times, values = read.signal(f"{name}.{signal.name}")
            assert len(values) == len(frames)
            if not frames:
                continue
            matrix = np.frombuffer(b"".join(f.data for f in frames), np.uint8).reshape(len(frames), -1)
            column = codec.decode_columns(matrix)[:, codec.signals.index(signal)]
            assert np.array_equal(values, column)
            decoded = [
                database.decode_message(name, f.data, decode_choices=False)[signal.name] for f in frames[:50]
            ]
            np.testing.assert_allclose(values[:50], decoded, rtol=1e-14)
            stamps = np.array([f.timestamp_ns - run.start_ns for f in frames])
            first_cycle_ns = 700_000  # phase of the controller, whose first cycle starts the recording
            np.testing.assert_allclose(times * NS_PER_S + first_cycle_ns, stamps, atol=1.0)
            checked += len(frames)
    assert checked > 20_000


def test_bus_time_is_absolute_and_exact_to_the_nanosecond(recorded):
    run, read, _ = recorded
    (stamps, _), _ = read.integer_columns("/bus/ODO_Motion", "ODO_Motion:Speed [km/h]")
    assert stamps.tolist() == [f.timestamp_ns for f in payloads(run, "ODO_Motion")]


def test_the_timelines_cycle_and_position_follow_the_controller_and_the_odometer(recorded):
    _, read, _ = recorded
    cycle, _ = read.signal("ATO_Command.EffortDemand", timeline="cycle")
    assert np.array_equal(cycle, np.arange(len(cycle)))
    place, odometer = read.signal("ODO_Motion.Position", timeline="position")
    assert np.array_equal(np.rint(place * 1000), odometer)
    place, _ = read.signal("BCU_Status.PneumaticEffort", timeline="position")
    assert np.max(np.abs(place[1:] - odometer[:-1] / 1000)) < 1e-9  # sent just before the odometer


def test_without_a_ring_the_commands_count_the_cycles(make_run, tmp_path):
    run = make_run(2.0)
    with Recorder(run.contract, RecorderOptions(tmp_path)) as recorder:
        run.play(recorder, {})
    read = open_run(tmp_path)
    assert read.processes == ()
    cycle, _ = read.signal("ATO_Command.EffortDemand", timeline="cycle")
    assert np.array_equal(cycle, np.arange(200))
    assert np.array_equal(read.signal("ODO_Motion.Speed", timeline="cycle")[0], np.arange(200))


def test_cycles_come_back_with_their_timing(recorded):
    run, read, _ = recorded
    assert read.processes == ("controller", "plant_sim")
    for process in run.rows:
        rows = np.array([row[:8] for row in run.rows[process]], np.int64)
        timing = read.timing(process)
        assert np.array_equal(timing["cycle"], rows[:, 0])
        assert np.array_equal(timing["wakeup_latency_us"], (rows[:, 2] - rows[:, 1]) / 1e3)
        assert np.array_equal(timing["step_us"], (rows[:, 4] - rows[:, 3]) / 1e3)
        np.testing.assert_allclose(timing["execution_us"], (rows[:, 6] - rows[:, 2]) / 1e3, atol=1e-6)
        np.testing.assert_allclose(timing["period_error_us"][1:], np.diff(rows[:, 2]) / 1e3 - 1e4, atol=1e-6)
        np.testing.assert_allclose(np.diff(timing["time_s"]), 0.01, atol=1e-9)


def test_probes_come_back_exactly(recorded):
    run, read, _ = recorded
    for process, probes in run.PROBES.items():
        assert read.probes(process) == dict(probes)
        for k, (name, _) in enumerate(probes):
            times, values = read.probe(process, name)
            assert np.array_equal(values, [row[8 + k] for row in run.rows[process]])
            assert len(times) == len(values)


def test_frames_and_cycles_share_one_clock(recorded):
    """A command is sent between the wake-up of its cycle and the next one."""
    _, read, _ = recorded
    sent, _ = read.signal("ATO_Command.EffortDemand")
    scheduled = read.timing("controller")["time_s"]
    assert np.all((sent - scheduled > 0) & (sent - scheduled < 0.01))


def test_the_frame_log_holds_every_frame_at_its_time(recorded):
    run, read, _ = recorded
    with can.BLFReader(read.path.parent / "frames.blf") as log:
        messages = list(log)
    assert [(m.arbitration_id, bytes(m.data)) for m in messages] == [(f.can_id, f.data) for f in run.frames]
    error = np.array([m.timestamp for m in messages]) - [f.timestamp_ns / NS_PER_S for f in run.frames]
    assert np.max(np.abs(error)) < 2e-6  # python-can counts time in floating-point seconds


def test_the_recording_carries_its_contract_and_properties(recorded):
    run, read, stats = recorded
    assert read.properties == {"name": "test", "law": "pid", "nested": {"numbers": [1, 2.5]}}
    assert read.dbc == dbc.path().read_text(encoding="utf-8")
    assert read.messages["ODO_Motion"].signals["Speed"] == "km/h"
    assert read.messages["ODO_Motion"].can_id == run.contract.message("ODO_Motion").can_id
    assert read.recording["frames"] == stats.frames
    assert read.warning == ""


def test_the_counts_are_those_of_the_run(recorded):
    run, _, stats = recorded
    assert stats.frames == len(run.frames)
    assert stats.frames_by_message["ODO_Motion"] == 800
    assert sum(stats.frames_by_message.values()) == len(run.frames)
    assert (stats.unknown_frames, stats.malformed_frames, stats.dropped) == (0, 0, 0)
    assert (stats.counter_lost, stats.counter_repeated) == ({}, {})
    assert {name: (ring.records, ring.lost) for name, ring in stats.rings.items()} == {
        "controller": (800, 0),
        "plant_sim": (800, 0),
    }
    assert stats.duration_s == pytest.approx(8.0, abs=0.02)
    assert all(size > 10_000 for size in stats.bytes.values())
    assert json.loads(json.dumps(stats.as_dict()))["rings"]["controller"] == {"records": 800, "lost": 0}


def test_a_finished_recording_passes_the_viewers_own_check(recorded):
    _, read, _ = recorded
    check = subprocess.run([viewer_binary(), "rrd", "verify", read.path], capture_output=True, text=True)
    assert check.returncode == 0, check.stderr


def test_lockstep_time_is_the_tick_of_the_last_sync(lockstep):
    run, read, _ = lockstep
    for name, every in (("ATO_Command", 1), ("TCU_Status", 1), ("ATP_Permission", 10), ("SYNC", 1)):
        signal = run.contract.message(name).signals[0].name
        times, _ = read.signal(f"{name}.{signal}")
        ticks = np.arange(0, 400, every)
        assert np.array_equal(np.rint(times * NS_PER_S), ticks * run.cycle_ns)
        assert np.array_equal(read.signal(f"{name}.{signal}", timeline="cycle")[0], ticks)


def test_in_lockstep_a_cycle_is_at_its_tick_and_never_late(lockstep):
    run, read, _ = lockstep
    for process in run.rows:
        timing = read.timing(process)
        assert np.array_equal(np.rint(timing["time_s"] * NS_PER_S), np.arange(400) * run.cycle_ns)
        assert not timing["wakeup_latency_us"].any()
        assert not timing["period_error_us"].any()
        assert np.all(timing["execution_us"] > 0)


def test_the_same_lockstep_run_gives_the_same_recorded_values(make_run, lockstep, tmp_path):
    _, first, _ = lockstep
    second, _ = make_run(4.0, clock="lockstep").record(tmp_path)
    for name in ("ODO_Motion.Speed", "ATO_Command.Counter", "BCU_Status.State"):
        assert np.array_equal(first.signal(name), second.signal(name))


def test_records_overwritten_in_a_ring_are_counted_as_lost(make_run, tmp_path):
    run = make_run(2.0)
    rings = run.open_rings(tmp_path, capacity=64)
    options = RecorderOptions(tmp_path, rings={name: ring.path for name, ring in rings.items()})
    with Recorder(run.contract, options) as recorder:
        run.play(recorder, rings, block_s=1.0)  # 100 cycles at a time into rings of 64
        stats = recorder.close()
    for ring in stats.rings.values():
        assert ring.lost >= 2 * (100 - 64)
        assert ring.records + ring.lost == 200
    assert len(open_run(tmp_path).timing("controller")["cycle"]) == stats.rings["controller"].records


def test_a_ring_that_appears_late_is_read(make_run, tmp_path):
    run = make_run(2.0)
    options = RecorderOptions(tmp_path, rings={name: tmp_path / f"{name}.ring" for name in run.rows})
    with Recorder(run.contract, options) as recorder:
        recorder.feed(run.frames[:100])
        recorder.flush()
        run.play(recorder, run.open_rings(tmp_path))
        assert recorder.close().rings["controller"].records == 200


def test_lost_and_repeated_frames_show_in_the_counters(make_run, tmp_path):
    run = make_run(2.0)
    motion = [k for k, frame in enumerate(run.frames) if frame.can_id == 0x184]
    gone = set(motion[50:53])
    frames = [frame for k, frame in enumerate(run.frames) if k not in gone]
    frames.insert(motion[20] + 1, run.frames[motion[20]])
    with Recorder(run.contract, RecorderOptions(tmp_path)) as recorder:
        for begin in range(0, len(frames), 77):
            recorder.feed(frames[begin : begin + 77])
            recorder.flush()
        stats = recorder.close()
    assert stats.counter_lost == {"ODO_Motion": 3}
    assert stats.counter_repeated == {"ODO_Motion": 1}


def test_frames_that_the_contract_does_not_have_are_logged_and_counted(contract, tmp_path):
    alien = [Frame(10**18 + k, 0x555, b"\x01\x02") for k in range(3)]
    short = [Frame(10**18 + 10, 0x184, b"\x00" * 5)]
    extended = [Frame(10**18 + 20, 0x8000_0000 | 0x12345, b"\x07")]
    with Recorder(contract, RecorderOptions(tmp_path)) as recorder:
        recorder.feed([*alien, *short, *extended])
        stats = recorder.close()
    assert (stats.frames, stats.unknown_frames, stats.malformed_frames) == (5, 4, 1)
    texts = [event.text for event in open_run(tmp_path).events()]
    assert len(texts) == 3
    assert any("0x555" in text for text in texts)
    with can.BLFReader(tmp_path / "frames.blf") as log:
        assert [(m.arbitration_id, m.is_extended_id) for m in log][-1] == (0x12345, True)


def test_a_recording_without_any_frame_is_whole(contract, tmp_path):
    with Recorder(contract, RecorderOptions(tmp_path)) as recorder:
        stats = recorder.close()
        assert recorder.close() is stats
    assert (stats.frames, stats.duration_s) == (0, 0.0)
    run = open_run(tmp_path)
    times, values = run.signal("ODO_Motion.Speed")
    assert len(times) == len(values) == 0
    assert run.events() == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"clock": "lockstep"}, ["tick"]),
        ({"clock": "sundial"}, ["sundial", "lockstep"]),
    ],
)
def test_options_that_make_no_sense_are_refused_in_one_line(contract, tmp_path, options, words):
    with pytest.raises(RecordError) as caught:
        Recorder(contract, RecorderOptions(tmp_path, **options))
    assert all(word in str(caught.value) for word in words)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_directory_that_cannot_be_written_is_said_in_one_line(contract, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match="cannot record there"):
        Recorder(contract, RecorderOptions(tmp_path / "file"))
