"""The pictures of one run: speed over distance, gradient, and the dashboard's charts over time.

Names, sources and colours are those of the dashboard (`hil.record.dashboard`): a curve here is found there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hil.bench.metrics import JERK_AVERAGE_S, JERK_DIFFERENCE_S, Array
from hil.bench.report.chart import Area, Chart, Curve, Mark
from hil.bench.report.source import RunSource
from hil.record.charts import conversion
from hil.record.dashboard import CHARTS, GREEN, ORANGE, RED, Series
from hil.record.dashboard import Chart as DashboardChart
from hil.record.run_data import RunData

__all__ = ["gradient_chart", "jerk_series", "over_distance", "position_at", "run_charts", "span_m"]

KMH = 3.6
MARGIN_M = 0.02
AXES = {"speed_error": "error"}
LIMITS = {"speed_error": ("rms_speed_error", "limit of its RMS"), "jerk": ("jerk", "limit")}
"""Criteria that are drawn into a chart, and how the line is called."""


def run_charts(source: RunSource) -> Iterator[Chart]:
    """All pictures for which something was recorded, in the order of the report."""
    run = source.recording
    if run is None:
        return
    charts = {chart.path: chart for chart in CHARTS}
    if "speed" in charts:
        yield _speed(source, run, charts["speed"])
    if source.journey is not None:
        yield gradient_chart(source)
    for key in ("effort", "demand", "speed_error", "acceleration"):
        if key in charts:
            yield _over_time(source, run, charts[key])
        if key == "acceleration":
            yield from _jerk(source, run)


def curve_of(run: RunData, chart: DashboardChart, series: Series) -> Curve | None:
    """A line of the dashboard over time; None if none of its sources was recorded."""
    for name in series.sources:
        if name not in run:
            continue
        column = run[name]
        factor = conversion(column.unit, chart.unit)
        if factor is None or not len(column):
            continue
        width = max(1.2, 0.7 * series.width)
        values = column.values * (factor * series.sign)
        return Curve(series.name, series.color, column.sim_time_s, values, width, series.step)
    return None


def position_at(run: RunData, time_s: Array) -> Array | None:
    """Where the train was [m]: the plant's account, else the odometer's; None if nobody told."""
    for name, factor in (("plant_sim.position_m", 1.0), ("ODO_Motion.Position", 1e-3)):
        if name in run and len(run[name]):
            column = run[name]
            place: Array = np.interp(time_s, column.sim_time_s, column.values * factor)
            return place
    return None


def over_distance(run: RunData, curve: Curve) -> Curve | None:
    """The same curve over the position of the train [m]."""
    place = position_at(run, curve.x)
    return None if place is None else replace(curve, x=place)


def span_m(source: RunSource) -> tuple[float, float] | None:
    """From stop to stop [m], and a little more."""
    if source.journey is None:
        return None
    start, end = source.journey.origin.position_m, source.journey.destination.position_m
    room = MARGIN_M * (end - start)
    return start - room, end + room


def duration_s(run: RunData) -> float:
    """When the recording ends [s]."""
    told = float(run.recording.get("duration_s") or 0.0)
    ends = [
        float(run[name].sim_time_s[-1]) for name in ("ATO_Command.Mode", "ODO_Motion.Speed") if len(run[name])
    ]
    return max(told, *ends, 1.0) if ends else max(told, 1.0)


def limit_marks(source: RunSource, chart: str) -> list[Mark]:
    """Both sides of the limit that the quantity of a chart was judged by."""
    criterion, name = LIMITS.get(chart, ("", ""))
    for row in source.summary.get("criteria", ()):
        if row.get("name") == criterion:
            limit = float(row["limit"])
            return [Mark(limit, f"{name} {limit:g}"), Mark(-limit, f"{name} −{limit:g}")]
    return []


def stations(source: RunSource) -> list[Mark]:
    """The stops of the line."""
    if source.journey is None:
        return []
    return [Mark(stop.position_m, stop.name, "x", "place") for stop in source.journey.line.stops]


def limits_area(source: RunSource) -> list[Area]:
    """What lies above the speed limits of the line [km/h]: every train's, whatever its length."""
    if source.journey is None:
        return []
    edges, limits = source.journey.line.speed_limit_profile()
    return [Area("above the line’s limit", RED, edges, limits * KMH)]


def _speed(source: RunSource, run: RunData, chart: DashboardChart) -> Chart:
    curves = [curve for series in chart.series if (curve := curve_of(run, chart, series))]
    placed = [line for curve in curves if (line := over_distance(run, curve))]
    # The reference lies on the others: dashed and above them, all three are seen.
    reference = [replace(line, dash="8 8", width=2.2) for line in placed if line.name == "reference"]
    placed = [line for line in placed if line.name != "reference"] + reference
    top = max((float(np.nanmax(line.y)) for line in placed if len(line.y)), default=0.0)
    areas = limits_area(source)
    if areas:
        top = max(top, float(areas[0].values.max()))
    true = next((line for line in placed if line.name in {"true", "measured"} and len(line.y)), None)
    said = "" if true is None else f" The highest speed was {true.y.max():.1f} km/h."
    return Chart(
        "speed",
        "Speed over distance",
        "distance [m]",
        "speed [km/h]",
        curves=placed,
        areas=areas,
        marks=stations(source),
        x_range=span_m(source),
        y_range=(0.0, top * 1.08 or 1.0),
        height_em=20.0,
        says=f"Speed over distance with the speed limits and the stations of the line.{said}",
        note="" if placed else "No speed was recorded.",
    )


def gradient_chart(source: RunSource) -> Chart:
    """The gradient of the line below the speed, on the same axis."""
    if source.journey is None:
        return Chart("gradient", "Gradient of the line", "distance [m]", "gradient [‰]")
    line = source.journey.line
    edges = line.breakpoints()
    middle = 0.5 * (edges[1:] + edges[:-1])
    values = np.array([line.gradient_permille(float(place)) for place in middle])
    reach = max(1.0, float(np.abs(values).max())) * 1.15
    level = "" if np.any(values) else "The line is level."
    return Chart(
        "gradient",
        "Gradient of the line",
        "distance [m]",
        "gradient [‰], uphill positive",
        areas=[Area("gradient", GREEN, edges, values, "zero")],
        marks=[replace(mark, name="") for mark in stations(source)],
        x_range=span_m(source),
        y_range=(-reach, reach),
        height_em=7.0,
        says=f"Gradient over distance, from {values.min():g} to {values.max():g} per mille. {level}",
        note=level,
    )


def _over_time(source: RunSource, run: RunData, chart: DashboardChart) -> Chart:
    curves = [curve for series in chart.series if (curve := curve_of(run, chart, series))]
    unit = chart.unit.replace("^2", "²")
    peaks = [f"{curve.name} from {curve.y.min():.3g} to {curve.y.max():.3g}" for curve in curves]
    return Chart(
        chart.path,
        chart.title,
        "time [s]",
        f"{AXES.get(chart.path, chart.path)} [{unit}]",
        curves=curves,
        marks=limit_marks(source, chart.path) if curves else (),
        x_range=(0.0, duration_s(run)),
        y_range=chart.limits,
        height_em=14.0,
        says=f"{chart.title} over time in {unit}: {'; '.join(peaks) or 'nothing recorded'}.",
        note="" if curves else "Nothing of this was recorded.",
    )


def jerk_series(time_s: Array, acceleration_mps2: Array) -> tuple[Array, Array]:
    """Jerk [m/s^3] over time as it is judged: `hil.bench.metrics.max_jerk_mps3` is the largest of these."""
    if len(time_s) < 3 or time_s[-1] - time_s[0] < JERK_AVERAGE_S + JERK_DIFFERENCE_S:
        return np.empty(0), np.empty(0)
    step = float(np.median(np.diff(time_s)))
    if step <= 0:
        return np.empty(0), np.empty(0)
    grid = np.arange(time_s[0], time_s[-1], step)
    acceleration = np.interp(grid, time_s, acceleration_mps2)
    window, lag = max(1, round(JERK_AVERAGE_S / step)), max(1, round(JERK_DIFFERENCE_S / step))
    average = np.convolve(acceleration, np.full(window, 1.0 / window), mode="valid")
    jerk = (average[lag:] - average[:-lag]) / (lag * step)
    return grid[: len(jerk)] + 0.5 * (window - 1 + lag) * step, jerk


def _jerk(source: RunSource, run: RunData) -> Iterator[Chart]:
    if "plant_sim.acceleration_mps2" not in run:
        return
    column = run["plant_sim.acceleration_mps2"]
    time_s, jerk = jerk_series(column.sim_time_s, column.values)
    if not len(jerk):
        return
    marks = limit_marks(source, "jerk")
    yield Chart(
        "jerk",
        "Jerk",
        "time [s]",
        "jerk [m/s³]",
        curves=[Curve("true, as it is judged", ORANGE, time_s, jerk)],
        marks=marks,
        x_range=(0.0, duration_s(run)),
        height_em=12.0,
        says=f"Jerk over time; the largest was {np.abs(jerk).max():.3g} m/s³"
        + (f", the limit is {marks[0].at:g}." if marks else "."),
    )
