"""What a reader sees: the viewer draws every tab of the dashboard, with its lines and colours."""

from __future__ import annotations

import time

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
from hil.record.dashboard import BLUE, GREEN, ORANGE, RED, VIOLET, WHITE, YELLOW
from hil.record.render import MISSING_DRIVER, headless_viewer, render, render_all, vulkan_driver_missing

pytestmark = [
    pytest.mark.needs_vulkan,
    pytest.mark.skipif(vulkan_driver_missing(), reason=MISSING_DRIVER),
    pytest.mark.timeout(240),
]

MENU_ROWS = 60  # the viewer's own bars, which are there even when nothing is drawn


@pytest.fixture(scope="module")
def recording(make_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("render")
    make_run(20.0).record(folder)
    return folder / "run.rrd"


@pytest.fixture(scope="module")
def pictures(recording, tmp_path_factory):
    """Tab -> picture as an array (height, width, 3)."""
    files = render_all(recording, tmp_path_factory.mktemp("pictures"))
    return {tab: np.array(Image.open(file).convert("RGB"))[MENU_ROWS:] for tab, file in files.items()}


def pixels(picture, rgba, *, tolerance=24):
    """How many pixels have about this colour."""
    color = np.array([rgba >> 24 & 0xFF, rgba >> 16 & 0xFF, rgba >> 8 & 0xFF])
    return int(np.count_nonzero(np.all(np.abs(picture.astype(int) - color) <= tolerance, axis=2)))


def test_all_tabs_are_drawn(pictures):
    assert list(pictures) == ["Drive", "Timing", "Bus", "Probes", "Events"]
    for tab, picture in pictures.items():
        assert picture.shape[1:] == (1920, 3)
        assert len(np.unique(picture @ [65536, 256, 1])) > 100, f"{tab} is blank"


@pytest.mark.parametrize(
    ("tab", "color"),
    [
        ("Drive", RED), ("Drive", YELLOW), ("Drive", GREEN), ("Drive", BLUE), ("Drive", ORANGE),
        ("Drive", WHITE), ("Timing", BLUE), ("Timing", GREEN), ("Timing", YELLOW), ("Bus", BLUE),
        ("Probes", BLUE), ("Probes", GREEN),
    ],
)  # fmt: skip
def test_the_lines_of_a_tab_are_there_in_their_colours(pictures, tab, color):
    assert pixels(pictures[tab], color) > 150


def test_the_bus_tab_draws_rates_and_states(pictures):
    bus = pictures["Bus"]
    states = bus[:, bus.shape[1] * 6 // 10 :]
    assert pixels(states, 0x3D9A6DFF, tolerance=20) > 10_000  # OPERATIONAL and OK, in green lanes
    rates = bus[: bus.shape[0] // 3, : bus.shape[1] // 2]
    assert pixels(rates, VIOLET) > 300  # ODO_Motion, the last one drawn at 100 frames a second


def test_the_events_tab_lists_an_error_in_red(pictures):
    events = pictures["Events"][:, :1000].astype(int)
    red = (events[:, :, 0] > 120) & (events[:, :, 1] < 60) & (events[:, :, 2] < 60)
    assert np.count_nonzero(red) > 20


def test_one_tab_alone_can_be_drawn(recording, tmp_path, pictures):
    render(recording, tmp_path / "new" / "timing.png", tab="Timing")
    picture = np.array(Image.open(tmp_path / "new" / "timing.png").convert("RGB"))[MENU_ROWS:]
    assert np.mean(picture != pictures["Timing"]) < 0.02


def test_an_unknown_tab_is_answered_with_the_known_ones(recording, tmp_path):
    with pytest.raises(RecordError, match="Drive, Timing, Bus, Probes, Events"):
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
