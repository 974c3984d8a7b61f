"""Curves keep their extremes, ticks are round, and every colour can be told from the page."""

import colorsys
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.bench.metrics import max_jerk_mps3
from hil.bench.report.axes import ticks
from hil.bench.report.chart import HEIGHT, WIDTH, Area, Chart, Curve, Mark, draw
from hil.bench.report.colours import contrast, on_light, rgb
from hil.bench.report.decimate import decimate
from hil.bench.report.pictures import jerk_series
from hil.record import dashboard


@given(st.integers(0, 2**32 - 1), st.integers(10, 20_000))
def test_a_decimated_curve_keeps_its_extremes_its_ends_and_its_order(seed, count):
    random = np.random.default_rng(seed)
    x, y = np.sort(random.uniform(0, 100, count)), random.normal(size=count)
    kept_x, kept_y = decimate(x, y, columns=100)
    assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())
    assert (kept_x[0], kept_x[-1]) == (x[0], x[-1])
    assert np.all(np.diff(kept_x) >= 0)
    assert len(kept_x) <= 4 * 100 + 2


def test_samples_that_are_not_numbers_are_left_out():
    x, y = decimate(np.arange(4.0), np.array([1.0, np.nan, 3.0, np.inf]))
    assert x.tolist() == [0.0, 2.0]
    assert y.tolist() == [1.0, 3.0]


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_ticks_lie_inside_and_are_few(low, span):
    found = ticks(low, low + span)
    assert 2 <= len(found) <= 7
    assert all(low - 1e-6 * span <= tick <= low + span * (1 + 1e-6) for tick in found)


def test_a_curve_lies_where_its_axes_say():
    curve = Curve("a", dashboard.BLUE, np.array([0.0, 5.0, 10.0]), np.array([0.0, 1.0, 0.5]))
    chart = Chart("c", "C", "x", "y", [curve], x_range=(0, 10), y_range=(0, 1))
    path = next(path for path in draw(chart).paths if path.kind == "curve")
    numbers = [int(word) for word in re.findall(r"\d+", path.data)]
    assert numbers == [0, HEIGHT, WIDTH // 2, 0, WIDTH, HEIGHT // 2]


def test_labels_at_one_place_get_rows_of_their_own():
    marks = [Mark(5.0, name, "x") for name in ("limit", "p99", "max")]
    chart = Chart(
        "c", "C", "x", "y", [Curve("a", dashboard.BLUE, np.arange(11.0), np.arange(11.0))], marks=marks
    )
    assert sorted(label.row for label in draw(chart).labels) == [0, 1, 2]


def test_a_chart_without_samples_is_not_drawn():
    empty = np.empty(0)
    assert draw(Chart("c", "C", "x", "y", [Curve("a", dashboard.BLUE, empty, empty)])) is None
    level = Area("a", dashboard.RED, np.array([0.0, 1.0]), np.array([3.0]))
    assert draw(Chart("c", "C", "x", "y", areas=[level])) is not None


def test_contrast_is_that_of_the_standard():
    # WCAG: black on white is 21; #767676 is the lightest grey with 4.5 on white.
    assert contrast(0x000000, 0xFFFFFF) == pytest.approx(21.0)
    assert contrast(0x767676, 0xFFFFFF) == pytest.approx(4.54, abs=0.01)
    assert contrast(0x777777, 0xFFFFFF) < 4.5


def test_every_colour_of_the_dashboard_can_be_seen_on_both_pages_and_keeps_its_hue():
    used = {series.color for chart in dashboard.CHARTS for series in chart.series} | set(dashboard.PALETTE)
    for color in used:
        dark, light = rgb(color), on_light(rgb(color))
        assert contrast(light, 0xFFFFFF) >= 3
        assert contrast(dark, 0x171A1F) >= 3
        hues = [
            colorsys.rgb_to_hsv(*(part / 255 for part in shade.to_bytes(3, "big"))) for shade in (dark, light)
        ]
        if min(saturation for _, saturation, _ in hues) > 0.3:
            assert abs(hues[0][0] - hues[1][0]) < 0.02


def test_the_drawn_jerk_is_the_judged_one():
    time_s = np.arange(0, 20, 0.01)
    acceleration = np.sin(time_s) + 0.2 * np.sin(7 * time_s)
    _, jerk = jerk_series(time_s, acceleration)
    assert np.abs(jerk).max() == max_jerk_mps3(time_s, acceleration)
