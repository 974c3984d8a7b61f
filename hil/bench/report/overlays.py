"""Curves of several runs over each other, over distance: each run has a colour of the dashboard's palette."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hil.bench.metrics import Array
from hil.bench.report.chart import Chart, Curve
from hil.bench.report.pictures import curve_of, jerk_series, limits_area, over_distance, span_m, stations
from hil.bench.report.source import RunSource
from hil.record.dashboard import CHARTS, PALETTE, RED

__all__ = ["overlay_charts", "run_color"]

COLORS = tuple(color for color in PALETTE if color != RED)  # red is what is not permitted
DASHES = ("", "9 4", "3 3", "9 3 3 3")
SAMPLES = 1200
STOP_M = 0.5
"""Left out before the stop: where a train creeps, a millimetre is worth a second."""
KMH = 3.6

Named = tuple[str, RunSource]


def run_color(place: int) -> int:
    """Colour of a run on the page, RGBA."""
    return COLORS[place % len(COLORS)]


def overlay_charts(runs: Sequence[Named]) -> Iterator[Chart]:
    """The pictures of a comparison; those for which no run has anything are left out."""
    yield from _speed(runs)
    yield from _differences(runs)
    for key in ("speed_error", "demand", "acceleration"):
        yield from _signal(runs, key)
    yield from _jerk(runs)


def _speed(runs: Sequence[Named]) -> Iterator[Chart]:
    curves = [curve for place, run in enumerate(runs) if (curve := _speed_over_distance(place, run))]
    first = next((source for _, source in runs if source.journey is not None), None)
    if not curves:
        return
    areas = limits_area(first) if first is not None else []
    top = max([float(np.nanmax(curve.y)) for curve in curves] + [float(a.values.max()) for a in areas])
    spans = [span for _, source in runs if (span := span_m(source)) is not None]
    yield Chart(
        "speed",
        "Speed over distance",
        "distance [m]",
        "speed [km/h]",
        curves=curves,
        areas=areas,
        marks=stations(first) if first is not None else (),
        x_range=(min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None,
        y_range=(0.0, 1.08 * top or 1.0),
        height_em=20.0,
        says="True speed of every run over distance, with the limits of the line of the first.",
        note="" if len(curves) == len(runs) else "Not every run has a recording of its speed.",
    )


def _speed_over_distance(place: int, run: Named) -> Curve | None:
    name, source = run
    recording = source.recording
    if recording is None:
        return None
    for signal, factor in (("plant_sim.speed_mps", KMH), ("ODO_Motion.Speed", 1.0)):
        if signal in recording and len(recording[signal]):
            column = recording[signal]
            curve = Curve(name, run_color(place), column.sim_time_s, column.values * factor, 2.0)
            placed = over_distance(recording, curve)
            return None if placed is None else replace(placed, dash=_dash(place))
    return None


def _differences(runs: Sequence[Named]) -> Iterator[Chart]:
    """Speed and time of the other runs minus those of the first, at the same place."""
    known = [_by_place(source) for _, source in runs]
    if known[0] is None:
        return
    base_place, base_time, base_speed = known[0]
    speeds, times = [], []
    for place, (name, _) in enumerate(runs):
        other = known[place]
        if place == 0 or other is None:
            continue
        places, time_s, speed = other
        low, high = max(base_place[0], places[0]), min(base_place[-1], places[-1]) - STOP_M
        if high <= low:
            continue
        grid = np.linspace(low, high, SAMPLES)
        faster = np.interp(grid, places, speed) - np.interp(grid, base_place, base_speed)
        later = np.interp(grid, places, time_s) - np.interp(grid, base_place, base_time)
        speeds.append(Curve(f"{name} − {runs[0][0]}", run_color(place), grid, faster * KMH, 1.6))
        times.append(Curve(f"{name} − {runs[0][0]}", run_color(place), grid, later, 1.6))
    for key, title, unit, curves in (
        ("speed-difference", "Difference of the speeds at the same place", "km/h", speeds),
        ("time-difference", "Difference of the times since departure at the same place", "s", times),
    ):
        if curves:
            largest = max(float(np.abs(curve.y).max()) for curve in curves)
            says = f"{title}, against the first run; the largest is {largest:.3g} {unit}."
            yield Chart(
                key, title, "distance [m]", f"difference [{unit}]", curves, marks=stations(runs[0][1]),
                x_range=span_m(runs[0][1]), height_em=12.0, says=says,
                note=f"Without the last {STOP_M:g} m, where the train creeps to its stop.",
            )  # fmt: skip


def _by_place(source: RunSource) -> tuple[Array, Array, Array] | None:
    """Places [m] that grow, time since the train first moved [s], speed [m/s]."""
    run = source.recording
    if run is None or not all(name in run for name in ("plant_sim.position_m", "plant_sim.speed_mps")):
        return None
    position, speed = run["plant_sim.position_m"], run["plant_sim.speed_mps"]
    count = min(len(position), len(speed))
    if count < 2:
        return None
    place, time_s = position.values[:count], position.sim_time_s[:count]
    ahead = np.concatenate(([True], np.diff(np.maximum.accumulate(place)) > 0))
    if np.count_nonzero(ahead) < 2:
        return None
    ahead[0] = False  # it may have stood there for long
    since_s = time_s[ahead] - time_s[ahead][0]
    return place[ahead], since_s, speed.values[:count][ahead]


def _signal(runs: Sequence[Named], key: str) -> Iterator[Chart]:
    chart = next((chart for chart in CHARTS if chart.path == key), None)
    if chart is None:
        return
    curves = []
    for place, (name, source) in enumerate(runs):
        if source.recording is None:
            continue
        # The last line of a chart is what really was: the true one, where there are several.
        curve = curve_of(source.recording, chart, chart.series[-1])
        placed = None if curve is None else over_distance(source.recording, curve)
        if placed is not None:
            curves.append(replace(placed, name=name, color=run_color(place), width=1.5))
    if curves:
        unit = chart.unit.replace("^2", "²")
        said = "; ".join(f"{curve.name} from {curve.y.min():.3g} to {curve.y.max():.3g}" for curve in curves)
        yield Chart(
            key, chart.title, "distance [m]", f"{key.replace('_', ' ')} [{unit}]", curves,
            marks=stations(runs[0][1]), x_range=span_m(runs[0][1]), y_range=chart.limits, height_em=13.0,
            says=f"{chart.title} over distance: {said}.",
        )  # fmt: skip


def _jerk(runs: Sequence[Named]) -> Iterator[Chart]:
    curves = []
    for place, (name, source) in enumerate(runs):
        run = source.recording
        if run is None or "plant_sim.acceleration_mps2" not in run:
            continue
        column = run["plant_sim.acceleration_mps2"]
        time_s, jerk = jerk_series(column.sim_time_s, column.values)
        placed = over_distance(run, Curve(name, run_color(place), time_s, jerk)) if len(jerk) else None
        if placed is not None:
            curves.append(placed)
    if curves:
        said = "; ".join(f"{curve.name} at most {np.abs(curve.y).max():.3g}" for curve in curves)
        yield Chart(
            "jerk", "Jerk, as it is judged", "distance [m]", "jerk [m/s³]", curves,
            marks=stations(runs[0][1]), x_range=span_m(runs[0][1]), height_em=12.0,
            says=f"Jerk over distance in m/s³: {said}.",
        )  # fmt: skip


def _dash(place: int) -> str:
    return DASHES[place % len(DASHES)]
