"""A chart over distance: the same series as over time, drawn as lines in a plane with its own axes.

A plot in the viewer runs over one timeline for all; a drawing shows distance beside time. It is replaced
as a whole every few seconds, and holds a bounded number of points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.record.dashboard import GREY, WHITE, Chart
from hil.record.rerun_sink import RerunSink

__all__ = ["HEIGHT", "WIDTH", "DistanceChart"]

WIDTH, HEIGHT = 1000.0, 360.0
"""Size of the plane in its own units; distance and value are scaled to fill it."""

MOST_POINTS = 1500
GRID = 0x26292EFF
TICKS = 6


@dataclass
class _Trace:
    """Points of one series, thinned to every `stride`-th."""

    distance_m: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    values: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    stride: int = 1
    skipped: int = 0

    def add(self, distance_m: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        chosen = slice((-self.skipped) % self.stride, None, self.stride)
        self.skipped = (self.skipped + len(values)) % self.stride
        self.distance_m = np.concatenate((self.distance_m, distance_m[chosen]))
        self.values = np.concatenate((self.values, values[chosen]))
        while len(self.values) > MOST_POINTS:
            self.distance_m, self.values = self.distance_m[::2], self.values[::2]
            self.stride *= 2


class DistanceChart:
    """Collects a chart's series over the position, and draws them."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.entity = f"/over_distance/{chart.path}"
        self._traces: dict[str, _Trace] = {}

    def add(self, name: str, position_m: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Take points of the series `name`."""
        known = np.isfinite(values)
        self._traces.setdefault(name, _Trace()).add(position_m[known], values[known])

    def draw(self, sink: RerunSink) -> None:
        """Replace the drawing by what is known now; nothing while the train has not moved."""
        traces = {name: trace for name, trace in self._traces.items() if len(trace.values) > 1}
        if not traces:
            return
        left = min(float(trace.distance_m.min()) for trace in traces.values())
        right = max(float(trace.distance_m.max()) for trace in traces.values())
        if right - left < 1.0:
            return
        low = min(0.0, *(float(trace.values.min()) for trace in traces.values()))
        high = max(float(trace.values.max()) for trace in traces.values())
        plane = _Plane(left, right, low, max(high * 1.05, low + 1.0))
        self._draw_axes(sink, plane)
        for series in self.chart.series:
            trace = traces.get(series.name)
            if trace is not None:
                points = plane.points(trace.distance_m, trace.values)
                sink.drawing(f"{self.entity}/{series.name}", [points], series.color, series.width)

    def _draw_axes(self, sink: RerunSink, plane: _Plane) -> None:
        across, up = _ticks(plane.left, plane.right), _ticks(plane.low, plane.high)
        grid = [plane.points(np.array([x, x]), np.array([plane.low, plane.high])) for x in across]
        grid += [plane.points(np.array([plane.left, plane.right]), np.array([y, y])) for y in up]
        sink.drawing(f"{self.entity}/axes/grid", grid, GRID, 0.7)
        below, beside = np.full(len(across), plane.low), np.full(len(up), plane.left)
        places = np.concatenate(
            (
                plane.points(np.array(across), below) + np.array([0.0, 0.07 * HEIGHT]),
                plane.points(beside, np.array(up)) - np.array([0.035 * WIDTH, 0.0]),
            )
        )
        texts = [f"{x:g} m" for x in across] + [f"{y:g}" for y in up]
        sink.labels(f"{self.entity}/axes/labels", places, texts, GREY)
        title = np.array([[0.06 * WIDTH, -1.06 * HEIGHT]])
        sink.labels(f"{self.entity}/axes/title", title, [f"{self.chart.title} [{self.chart.unit}]"], WHITE)


@dataclass(frozen=True)
class _Plane:
    """Where a point of the chart lies in the plane; its vertical axis points down, as in a picture."""

    left: float
    right: float
    low: float
    high: float

    def points(self, distance_m: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        across = (distance_m - self.left) / (self.right - self.left) * WIDTH
        up = (values - self.low) / (self.high - self.low) * HEIGHT
        return np.column_stack((across, -up))


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between low and high, about `TICKS` of them: steps of 1, 2 or 5 times a power of ten."""
    raw = (high - low) / TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= raw)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]
