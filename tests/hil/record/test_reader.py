"""Reading back: whole files, files of a killed recorder, files cut short, and names that do not exist."""

from __future__ import annotations

import shutil
import warnings

import numpy as np
import pytest

from hil.record import Recorder, RecorderOptions, RecordError, RecordingUnreadable, open_run


@pytest.fixture(scope="module")
def folder(make_run, tmp_path_factory):
    """A directory with a finished recording of 3 s."""
    path = tmp_path_factory.mktemp("finished")
    make_run(3.0).record(path, properties={"name": "read me"})
    return path


@pytest.fixture
def unfinished(make_run, tmp_path):
    """An .rrd as a killed recorder leaves it: everything flushed, no footer."""
    run = make_run(3.0)
    recorder = Recorder(run.contract, RecorderOptions(tmp_path / "running"))
    run.play(recorder, {})
    recorder.flush()
    recorder._pages._sink.flush()
    copy = tmp_path / "copy.rrd"
    shutil.copy(tmp_path / "running" / "run.rrd", copy)
    yield run, copy
    recorder.close()


def test_a_run_is_found_by_its_directory_and_by_its_file(folder):
    by_folder, by_file = open_run(folder), open_run(str(folder / "run.rrd"))
    assert np.array_equal(by_folder.signal("ODO_Motion.Speed"), by_file.signal("ODO_Motion.Speed"))
    assert len(by_folder.signal("ODO_Motion.Speed")[0]) == 300


def test_places_can_be_given_on_every_timeline(folder):
    run = open_run(folder)
    for timeline in ("sim_time", "bus_time", "cycle", "position"):
        places, values = run.signal("ODO_Motion.Speed", timeline=timeline)
        assert len(places) == len(values) == 300
        assert np.all(np.diff(places) >= 0)
    assert run.signal("ODO_Motion.Speed", timeline="bus_time")[0][0] == pytest.approx(1.79e9)


def test_events_are_read_in_the_order_of_time(folder):
    events = open_run(folder).events()
    assert np.all(np.diff([event.time_s for event in events]) >= 0)
    emergency = [event for event in events if event.level == "ERROR"]
    assert [event.source for event in emergency] == ["TCU"]
    assert "COMMAND_LOST" in emergency[0].text


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda run: run.signal("Nothing.Speed"), ["Nothing", "ODO_Motion"]),
        (lambda run: run.signal("ODO_Motion.Sped"), ["Sped", "Speed", "Position"]),
        (lambda run: run.signal("ODO_Motion"), ["ODO_Motion", "Speed"]),
        (lambda run: run.signal("ODO_Motion.Speed", timeline="moon"), ["moon", "sim_time"]),
        (lambda run: run.probe("plant_sim", "sped"), ["sped", "speed_mps"]),
        (lambda run: run.timing("brake"), ["brake", "controller"]),
    ],
)
def test_an_unknown_name_is_answered_with_the_known_ones(folder, ask, words):
    with pytest.raises(RecordError) as caught:
        ask(open_run(folder))
    assert all(word in str(caught.value) for word in words)
    assert "\n" not in str(caught.value)


def test_a_killed_recorders_file_is_read_with_a_warning(unfinished):
    run, copy = unfinished
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = open_run(copy)
    assert "did not finish" in read.warning
    sent = [frame for frame in run.frames if frame.can_id == run.contract.message("ODO_Motion").can_id]
    assert len(read.signal("ODO_Motion.Speed")[0]) == len(sent)
    assert read.recording == {}


def test_a_file_cut_in_the_middle_gives_what_is_whole(unfinished, tmp_path):
    _, copy = unfinished
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(copy.read_bytes()[: copy.stat().st_size * 2 // 3])
    read = open_run(cut)
    assert "cut" in read.warning
    assert 0 < len(read.signal("ODO_Motion.Speed")[0]) < 300


@pytest.mark.parametrize("content", [None, b"", b"no recording at all", b"RRF2" + bytes(100)])
def test_a_file_that_is_no_recording_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "run.rrd"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingUnreadable) as caught:
        open_run(tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
