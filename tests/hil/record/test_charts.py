"""The dashboard: every line finds its source, units fit, and what is missing is left out."""

from __future__ import annotations

import numpy as np
import pytest

from hil.record.blueprint import Layout, build_blueprint
from hil.record.charts import Charts, Source, conversion
from hil.record.dashboard import CHARTS, LANES, POSITION, Chart, Series, state_color
from hil.record.distance import WIDTH, DistanceChart, _ticks
from hil.record.events import is_state
from hil.record.timelines import Instants

CHART = Chart(
    "speed",
    "Speed",
    "km/h",
    (Series("true", ("plant/speed_mps", "Bus.Speed"), 0xFF), Series("gone", ("No.Where",), 1)),
)


class Paper:
    """A sink that keeps what is drawn."""

    def __init__(self):
        self.drawn = {}

    def drawing(self, entity, strips, color, width=1.0):
        self.drawn[entity] = strips

    def labels(self, entity, places, texts, color):
        self.drawn[entity] = texts


def instants(position_m):
    n = len(position_m)
    return Instants(0, np.arange(n), np.arange(n), np.rint(np.asarray(position_m) * 1000).astype(np.int64))


@pytest.mark.parametrize(
    ("unit", "wanted", "factor"),
    [
        ("m/s", "km/h", 3.6),
        ("N", "kN", 1e-3),
        ("m/s2", "m/s^2", 1.0),
        ("odd", "odd", 1.0),
        ("m", "km/h", None),
        ("odd", "m", None),
    ],
)
def test_units_are_converted_or_refused(unit, wanted, factor):
    assert conversion(unit, wanted) == (None if factor is None else pytest.approx(factor))


def test_a_better_source_replaces_a_worse_one_and_a_line_without_any_is_left_out():
    charts = Charts([CHART], Paper())
    assert charts.lines == []
    charts.offer({"Bus.Speed": Source("/bus/Bus", "Bus", "Speed", "km/h")})
    assert [line.component for line in charts.lines] == ["Bus:Speed [km/h]"]
    charts.offer({"plant/speed_mps": Source("/probe/plant", "plant", "speed_mps", "m/s")})
    assert [(line.source.entity, line.component) for line in charts.lines] == [
        ("/probe/plant", "plant:speed [km/h]")
    ]


def test_only_a_source_in_another_unit_gets_a_converted_column():
    charts = Charts([CHART], Paper())
    charts.offer({"plant/speed_mps": Source("/probe/plant", "plant", "speed_mps", "m/s")})
    extra = charts.take("plant/speed_mps", instants([0.0, 1.0]), np.array([1.0, 2.0]))
    assert list(extra) == ["speed [km/h]"]
    np.testing.assert_allclose(extra["speed [km/h]"], [3.6, 7.2])
    charts.offer({"plant/speed_mps": Source("/probe/plant", "plant", "speed_mps", "km/h")})
    assert charts.take("plant/speed_mps", instants([0.0]), np.array([1.0])) == {}


def test_the_table_of_the_dashboard_fits_the_shipped_contract(contract):
    """Every bus signal that the first page names exists, in a unit that its chart can show."""
    for chart in CHARTS:
        for series in chart.series:
            for source in (source for source in series.sources if "." in source):
                message, signal = source.split(".")
                assert conversion(contract.message(message).signal(signal).unit, chart.unit) is not None
    for lane in LANES:
        message, signal = lane.split(".")
        assert is_state(contract.message(message).signal(signal))
    assert contract.message(POSITION.split(".")[0]).signal(POSITION.split(".")[1]).unit == "mm"


def test_a_bad_state_is_red_in_every_lane():
    assert state_color("EMERGENCY", 3) == state_color("FAULT", 5) == state_color("YES", 1, "EmergencyApplied")
    assert state_color("NORMAL", 0) != state_color("EMERGENCY", 6)


def test_the_chart_over_distance_spans_what_was_driven():
    paper, chart = Paper(), DistanceChart(Chart("speed", "Speed", "km/h", CHART.series, distance=True))
    chart.draw(paper)
    assert paper.drawn == {}
    distance = np.linspace(500.0, 1500.0, 400)
    chart.add("true", distance, 40 + 40 * np.sin(np.linspace(0, np.pi, 400)))
    chart.draw(paper)
    curve = paper.drawn["/over_distance/speed/true"][0]
    assert curve[0, 0] == pytest.approx(0.0)
    assert curve[-1, 0] == pytest.approx(WIDTH)
    assert curve[:, 1].min() < curve[0, 1] < 0  # upwards is negative in the plane
    labels = paper.drawn["/over_distance/speed/axes/labels"]
    assert {"600 m", "1000 m", "0", "80"} <= set(labels)


def test_a_chart_over_distance_keeps_a_bounded_number_of_points():
    paper, chart = Paper(), DistanceChart(CHART)
    for begin in range(0, 100_000, 500):
        distance = np.arange(begin, begin + 500) / 100
        chart.add("true", distance, np.full(500, 50.0))
    chart.draw(paper)
    curve = paper.drawn["/over_distance/speed/true"][0]
    assert 500 <= len(curve) <= 1500
    assert curve[-1, 0] > 0.98 * WIDTH


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0, 83.5), (-3, 931.2), (12_000, 12_050)])
def test_ticks_are_few_round_and_inside(low, high):
    ticks = _ticks(low, high)
    assert 3 <= len(ticks) <= 8
    assert low - 1e-9 <= ticks[0] <= ticks[-1] <= high + 1e-9
    assert np.allclose(np.diff(ticks), ticks[1] - ticks[0])


def test_a_blueprint_without_anything_to_show_can_be_built():
    assert build_blueprint(Layout()).root_container is not None
