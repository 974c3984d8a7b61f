"""What a reader sees: the viewer draws every tab of the dashboard, with its lines and colours."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hil.record import (
    Recorder,
    RecorderOptions,
    RecordError,
    RecordingUnreadable,
    ViewerUnavailable,
    open_run,
)
from hil.record.about import add_verdict
from hil.record.dashboard import BLUE, CYAN, GREEN, GREY, LIMIT, ORANGE, RED, VIOLET, WHITE, YELLOW
from hil.record.render import MISSING_DRIVER, headless_viewer, render, render_views, vulkan_driver_missing

pytestmark = [
    pytest.mark.needs_vulkan,
    pytest.mark.skipif(vulkan_driver_missing(), reason=MISSING_DRIVER),
    pytest.mark.timeout(240),
]

TRAIN = ORANGE
STATE_GREEN, BARS_BLUE, BARS_GREEN = 0x3D9A6DFF, 0x4280C8FF, 0x3F9C70FF  # as the viewer shades lanes and bars
TITLE_ROWS = 30
INFO_GREEN = 0x00D78AFF  # the viewer's colour of the level INFO
SUMMARY = {
    "verdict": "passed", "ended": "arrived",
    "criteria": [{"name": "stop_error", "value": 0.01, "limit": 0.3, "unit": "m", "passed": True}],
}  # fmt: skip
MENU_ROWS = 60  # the viewer's own bars, which are there even when nothing is drawn


@pytest.fixture(scope="module")
def recording(make_run, tmp_path_factory, line, law):
    folder = tmp_path_factory.mktemp("render")
    limits = {"jerk_mps3": 1.0, "rms_speed_error_mps": 0.05, "max_deadline_misses": 3}
    about = {"track": line, "law_picture": law, "limits": limits, "bitrate": 500_000}
    make_run(20.0).record(folder, properties={**about, "period_us": {"controller": 10_000.0}})
    add_verdict(folder / "run.rrd", SUMMARY)
    return folder / "run.rrd"


@pytest.fixture(scope="module")
def views(recording, tmp_path_factory):
    """Tab -> name of the view, "" for the whole tab -> picture (height, width, 3).

    The files stay in the folder that HIL_PICTURES names, so that a build can show them.
    """
    kept = os.environ.get("HIL_PICTURES")
    folder = Path(kept) if kept else tmp_path_factory.mktemp("pictures")
    return {
        tab: {name: np.array(Image.open(file).convert("RGB")) for name, file in files.items()}
        for tab, files in render_views(recording, folder).items()
    }


@pytest.fixture(scope="module")
def pictures(views):
    """Tab -> picture as an array (height, width, 3), without the viewer's own bars."""
    return {tab: cuts[""][MENU_ROWS:] for tab, cuts in views.items()}


def pixels(picture, rgba, *, tolerance=24):
    """How many pixels have about this colour."""
    color = np.array([rgba >> 24 & 0xFF, rgba >> 16 & 0xFF, rgba >> 8 & 0xFF])
    return int(np.count_nonzero(np.all(np.abs(picture.astype(int) - color) <= tolerance, axis=2)))


def test_all_tabs_are_drawn(pictures):
    assert list(pictures) == ["Drive", "Law", "Timing", "Bus", "Probes", "Events"]
    for tab, picture in pictures.items():
        assert picture.shape[1:] == (1920, 3)
        assert len(np.unique(picture @ [65536, 256, 1])) > 100, f"{tab} is blank"


@pytest.mark.parametrize(
    ("tab", "color"),
    [
        ("Drive", RED), ("Drive", YELLOW), ("Drive", GREEN), ("Drive", BLUE), ("Drive", ORANGE),
        ("Drive", WHITE), ("Timing", BLUE), ("Timing", GREEN), ("Timing", ORANGE), ("Bus", BLUE),
        ("Probes", BLUE), ("Probes", GREEN),
    ],
)  # fmt: skip
def test_the_lines_of_a_tab_are_there_in_their_colours(pictures, tab, color):
    assert pixels(pictures[tab], color) > 150


SERIES = {
    "Drive": {
        "Speed [km/h] over distance": (LIMIT, RED, BLUE, WHITE, TRAIN),
        "Speed [km/h]": (RED, BLUE, YELLOW, WHITE),
        "Effort at the wheels": (GREEN, VIOLET, CYAN),
        "Acceleration": (YELLOW, WHITE),
        "Tracking error": (YELLOW, LIMIT),
        "Effort demand": (ORANGE,),
        "Jerk": (WHITE, LIMIT),
        "States": (STATE_GREEN,),
    },
    "Law": {
        "Demand by the rules": (0x2654A0FF, 0xC86028FF, WHITE),
        "Rules that fire": (0xD69632FF,),
        "Speed error": (YELLOW, LIMIT),
    },
    "Timing": {
        "Wake-up latency [us]": (BLUE, GREEN),
        "Execution of controller": (CYAN, ORANGE, VIOLET, GREEN),
        "Execution of plant_sim": (CYAN, ORANGE, VIOLET, GREEN),
        "From due to sent": (LIMIT, GREEN),
        "Missed cycles so far": (LIMIT,),
        "Oldest signal that was used": (BLUE, GREEN, LIMIT),
        "Wake-up latency: log10": (BARS_BLUE, BARS_GREEN),
        "Execution: log10": (BARS_BLUE, BARS_GREEN),
        "Percentiles": (),
    },
    "Bus": {
        "Bus load": (BLUE,),
        "Longest interval": (BLUE, VIOLET),
        "Shortest interval": (BLUE, VIOLET),
        "Frames per second": (GREEN, VIOLET),
        "E2E state of commands": (STATE_GREEN,),
        "So far: lost": (),
    },
    "Events": {
        "Events": (),
        "Verdict": (),
        "Run": (),
        "Mode, supervision, faults, verdict": (STATE_GREEN, GREY),
        "All other states": (STATE_GREEN,),
    },
}


def test_every_view_has_drawn_its_series(views):
    missing = []
    for tab, expected in SERIES.items():
        names = [name for name in views[tab] if name]
        assert len(names) == len(expected), (tab, names)
        for start, tints in expected.items():
            name = next(name for name in names if name.startswith(start) and name != "")
            inside = views[tab][name][TITLE_ROWS:]
            assert len(np.unique(inside @ [65536, 256, 1])) > 20, f"{tab}, {name} is blank"
            missing += [
                f"{tab}, {name}: {tint:08x}" for tint in tints if pixels(inside, tint, tolerance=40) < 12
            ]
    assert not missing


def test_every_view_of_probes_has_drawn_a_line(views):
    for name, picture in views["Probes"].items():
        bright = picture[TITLE_ROWS:].max(axis=2) > 150
        assert np.count_nonzero(bright) > 300, name


def test_the_bus_tab_draws_states(pictures):
    bus = pictures["Bus"]
    states = bus[:, bus.shape[1] * 6 // 10 :]
    assert pixels(states, 0x3D9A6DFF, tolerance=20) > 10_000  # OPERATIONAL and OK, in green lanes


def test_the_events_tab_lists_events_with_their_levels(views):
    assert pixels(views["Events"]["Events"], INFO_GREEN, tolerance=40) > 200


def test_one_tab_alone_can_be_drawn(recording, tmp_path, pictures):
    render(recording, tmp_path / "new" / "timing.png", tab="Timing")
    picture = np.array(Image.open(tmp_path / "new" / "timing.png").convert("RGB"))[MENU_ROWS:]
    assert np.mean(picture != pictures["Timing"]) < 0.02


def test_an_unknown_tab_is_answered_with_the_known_ones(recording, tmp_path):
    with pytest.raises(RecordError, match="Drive, Law, Timing, Bus, Probes, Events"):
        render(recording, tmp_path / "x.png", tab="Moon")


def test_a_missing_recording_is_said(tmp_path):
    with pytest.raises(RecordingUnreadable):
        render(tmp_path / "none.rrd", tmp_path / "x.png")


def test_without_a_driver_the_package_to_install_is_named(recording, tmp_path, monkeypatch):
    monkeypatch.setattr("hil.record.render.vulkan_driver_missing", lambda: True)
    with pytest.raises(ViewerUnavailable, match="mesa-vulkan-drivers") as caught:
        render(recording, tmp_path / "x.png")
    assert caught.value.exit_code == 3
    assert "make system-deps" in str(caught.value)


def test_a_live_viewer_sees_the_run_while_it_goes_on(make_run, tmp_path):
    """The same data go to the file and to a viewer; the viewer may vanish without harm to the file."""
    run = make_run(4.0)
    half = len(run.frames) // 2
    with headless_viewer() as viewer:
        recorder = Recorder(run.contract, RecorderOptions(tmp_path, viewer_url=viewer.url))
        recorder.feed(run.frames[:half])
        recorder.flush()
        deadline = time.monotonic() + 30
        while not (seen := viewer.get_state().recordings) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert len(seen) == 1
    recorder.feed(run.frames[half:])
    stats = recorder.close()
    assert stats.frames == len(run.frames)
    sent = sum(frame.can_id == run.contract.message("ODO_Motion").can_id for frame in run.frames)
    assert len(open_run(tmp_path).signal("ODO_Motion.Speed")[0]) == sent
