"""A picture as data, and how it becomes SVG: the curves scale with the page, the text beside them does not.

Curves are paths in a box of WIDTH x HEIGHT that the browser stretches (`preserveAspectRatio="none"`, strokes
that keep their width); ticks, legend and labels are text of the page at places in per cent. So it is as
readable on a phone as on paper.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.bench.report.axes import decades, plain, ticks
from hil.bench.report.decimate import decimate

__all__ = ["HEIGHT", "WIDTH", "Area", "Bars", "Chart", "Curve", "Drawing", "Label", "Mark", "Path", "draw"]

Array = NDArray[np.float64]
WIDTH, HEIGHT = 2400, 1000
LABEL_ROWS = 6


@dataclass(frozen=True)
class Curve:
    """One line: `x` and `y` (n), colour of the dashboard (RGBA), width in pixels.

    `step`: held until the next value. `dash`: as in SVG.
    """

    name: str
    color: int
    x: Array
    y: Array
    width: float = 1.5
    step: bool = False
    dash: str = ""


@dataclass(frozen=True)
class Bars:
    """A histogram: `edges` (n+1) and heights (n), filled from the bottom of the picture."""

    name: str
    color: int
    edges: Array
    heights: Array


@dataclass(frozen=True)
class Area:
    """A region between a stepped edge and the top (or zero): `edges` (n+1), `values` (n)."""

    name: str
    color: int
    edges: Array
    values: Array
    to: str = "top"  # or "zero"


@dataclass(frozen=True)
class Mark:
    """A limit or a place: a straight line at a value of one axis, with its name. `kind`: limit or place."""

    at: float
    name: str
    axis: str = "y"
    kind: str = "limit"


@dataclass(frozen=True)
class Chart:
    """One picture. `x_range` and `y_range` None: those of the data. `log`: powers of ten on the x axis.

    `says` is what a reader who cannot see it is told.
    """

    key: str
    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve] = ()
    bars: Sequence[Bars] = ()
    areas: Sequence[Area] = ()
    marks: Sequence[Mark] = ()
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: bool = False
    log_count: bool = False
    height_em: float = 15.0
    says: str = ""
    note: str = ""

    @property
    def colors(self) -> list[int]:
        """Colours that it uses."""
        parts: list[Curve | Bars | Area] = [*self.curves, *self.bars, *self.areas]
        return [part.color for part in parts]


@dataclass(frozen=True)
class Label:
    """Text at a place along an axis, per cent from the left or the top; `row` keeps neighbours apart."""

    percent: float
    text: str
    row: int = 0
    kind: str = ""
    side: str = ""


@dataclass(frozen=True)
class Path:
    """SVG path data with its look: `kind` is a class of the style sheet."""

    data: str
    kind: str
    color: int = 0
    width: float = 1.0
    dash: str = ""


@dataclass
class Drawing:
    """A chart with everything placed: what the template writes down."""

    chart: Chart
    paths: list[Path] = field(default_factory=list)
    x_ticks: list[Label] = field(default_factory=list)
    y_ticks: list[Label] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    rules: list[Label] = field(default_factory=list)
    legend: list[Path | tuple[str, Path]] = field(default_factory=list)
    rows: int = 0


def draw(chart: Chart) -> Drawing | None:
    """Place a chart; None if there is nothing to draw."""
    plane = _plane(chart)
    if plane is None:
        return None
    drawing = Drawing(chart)
    _grid(chart, plane, drawing)
    for area in chart.areas:
        path = Path(plane.area(area), "area", area.color)
        drawing.paths.append(path)
        drawing.legend.append((area.name, path))
    for bars in chart.bars:
        path = Path(plane.bars(bars), "bars", bars.color)
        drawing.paths.append(path)
        drawing.legend.append((bars.name, path))
    _marks(chart, plane, drawing)
    for curve in chart.curves:
        x, y = decimate(curve.x, curve.y, step=curve.step)
        path = Path(plane.curve(x, y, step=curve.step), "curve", curve.color, curve.width, curve.dash)
        drawing.paths.append(path)
        drawing.legend.append((curve.name, path))
    return drawing


@dataclass(frozen=True)
class _Plane:
    left: float
    right: float
    low: float
    high: float
    log: bool

    def across(self, x: Array | float) -> Array:
        if self.log:
            x = np.log10(np.maximum(x, 1e-12))
            return np.asarray((x - math.log10(self.left)) / math.log10(self.right / self.left))
        return np.asarray((np.asarray(x) - self.left) / (self.right - self.left))

    def down(self, y: Array | float) -> Array:
        return np.asarray(1.0 - (np.asarray(y) - self.low) / (self.high - self.low))

    def curve(self, x: Array, y: Array, *, step: bool = False) -> str:
        if not len(x):
            return ""
        across, down = self._pixels(x, y)
        keep = np.concatenate(([True], (np.diff(across) != 0) | (np.diff(down) != 0)))
        points = list(zip(across[keep].tolist(), down[keep].tolist(), strict=True))
        start, *rest = points
        if step:
            last, words = start, [f"M{start[0]} {start[1]}"]
            for point in rest:
                words.append(f"H{point[0]}" if point[1] == last[1] else f"H{point[0]}V{point[1]}")
                last = point
            return "".join(words)
        return f"M{start[0]} {start[1]}L" + " ".join(f"{u} {v}" for u, v in rest)

    def bars(self, bars: Bars) -> str:
        heights = np.maximum(bars.heights, self.low)
        return self._stepped(bars.edges, heights, HEIGHT)

    def area(self, area: Area) -> str:
        base = 0 if area.to == "top" else round(float(self.down(0.0)) * HEIGHT)
        return self._stepped(area.edges, area.values, base)

    def _stepped(self, edges: Array, values: Array, base: int) -> str:
        across, _ = self._pixels(edges, np.full(len(edges), self.low))
        _, down = self._pixels(np.full(len(values), self.left), values)
        words = [f"M{across[0]} {base}"]
        for right, level in zip(across[1:].tolist(), down.tolist(), strict=True):
            words.append(f"V{level}H{right}")
        return "".join([*words, f"V{base}Z"])

    def _pixels(self, x: Array, y: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        across = np.clip(self.across(x), -0.1, 1.1) * WIDTH
        down = np.clip(self.down(y), -1.0, 2.0) * HEIGHT
        return np.rint(across).astype(np.int64), np.rint(down).astype(np.int64)


def _plane(chart: Chart) -> _Plane | None:
    drawn = [(curve.x, curve.y) for curve in chart.curves]
    drawn += [(bars.edges, np.append(bars.heights, 0.0)) for bars in chart.bars]
    drawn += [(area.edges, area.values) for area in chart.areas]
    drawn = [(x[np.isfinite(x)], y[np.isfinite(y)]) for x, y in drawn]
    drawn = [(x, y) for x, y in drawn if len(x) and len(y)]
    if not drawn:
        return None
    left, right = chart.x_range or (min(x.min() for x, _ in drawn), max(x.max() for x, _ in drawn))
    if chart.y_range is not None:
        low, high = chart.y_range
    else:
        places = [mark.at for mark in chart.marks if mark.axis == "y"]
        low = min([*(float(y.min()) for _, y in drawn), *places])
        high = max([*(float(y.max()) for _, y in drawn), *places])
        room = (0.12 if places else 0.05) * (high - low) or 1.0  # a limit has its name above it
        low, high = (low if low == 0 else low - room), high + room
    if right <= left:
        right = left + 1.0
    if high <= low:
        high = low + 1.0
    return _Plane(float(left), float(right), float(low), float(high), chart.log)


def _grid(chart: Chart, plane: _Plane, drawing: Drawing) -> None:
    across = decades(plane.left, plane.right) if chart.log else ticks(plane.left, plane.right)
    up = ticks(plane.low, plane.high)
    if chart.log_count:
        up = [float(k) for k in range(math.floor(plane.high) + 1)]
    lines = []
    for x in across:
        percent = 100 * float(plane.across(x))
        least = "≤ " if chart.log and x == plane.left else ""  # what is shorter is counted in the first bar
        drawing.x_ticks.append(Label(percent, least + plain(x)))
        lines.append(f"M{round(percent * WIDTH / 100)} 0V{HEIGHT}")
    for y in up:
        percent = 100 * float(plane.down(y))
        text = plain(10.0**y) if chart.log_count else plain(y)
        drawing.y_ticks.append(Label(percent, text))
        lines.append(f"M0 {round(percent * HEIGHT / 100)}H{WIDTH}")
    drawing.paths.append(Path("".join(lines), "grid"))
    if plane.low < 0 < plane.high and not chart.log_count:
        drawing.paths.append(Path(f"M0 {round(float(plane.down(0.0)) * HEIGHT)}H{WIDTH}", "zero"))


def _marks(chart: Chart, plane: _Plane, drawing: Drawing) -> None:
    free = [-1e9] * LABEL_ROWS
    for mark in sorted(chart.marks, key=lambda mark: mark.at):
        if mark.axis == "y":
            percent = 100 * float(plane.down(mark.at))
            drawing.paths.append(Path(f"M0 {round(percent * HEIGHT / 100)}H{WIDTH}", mark.kind))
            drawing.rules.append(Label(percent, mark.name, kind=mark.kind))
            continue
        percent = 100 * float(plane.across(mark.at))
        if not -0.1 <= percent <= 100.1:
            continue
        drawing.paths.append(Path(f"M{round(percent * WIDTH / 100)} 0V{HEIGHT}", mark.kind))
        side = "end" if percent > 72 else ""
        # On a phone a letter is about two per cent of the width.
        reach = 2.2 * len(mark.name) + 2
        first, last = (percent - reach, percent) if side else (percent, percent + reach)
        row = next((k for k, end in enumerate(free) if end <= first), LABEL_ROWS - 1)
        free[row] = last
        drawing.labels.append(Label(percent, mark.name, row, mark.kind, side))
        drawing.rows = max(drawing.rows, row + 1)
