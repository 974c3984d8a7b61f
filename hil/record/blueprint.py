"""The dashboard: how the viewer lays out a recording when it opens it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from hil.record.about import RUN_DOCUMENT, VERDICT_DOCUMENT, VERDICT_LANE
from hil.record.charts import ChartLine
from hil.record.cycle_pages import TIMING_GROUP
from hil.record.dashboard import (
    BLUE,
    CYAN,
    GREEN,
    LIMIT,
    ORANGE,
    PALETTE,
    RED,
    VIOLET,
    Chart,
    colors,
    probe_color,
)
from hil.record.distance import HEIGHT, WIDTH
from hil.record.law_page import SURFACE
from hil.record.levels import LevelLine
from hil.record.line_map import MAP_DEPTH
from hil.record.rerun_sink import component_name, with_unit
from hil.record.rings import TIMING_COLUMNS

__all__ = ["TABS", "Layout", "build_blueprint"]

TABS = ("Drive", "Law", "Timing", "Bus", "Probes", "Events")
"""The tabs in their order; `Law` and `Probes` are left out when there is nothing to show."""


MESSAGE_FIGURES = ("frames_per_second", "longest_interval", "shortest_interval", "counter_errors")
FIRST_LANES = ("Mode", "Supervision", "SupervisionState", "ErrorCode")
"""Signals whose lanes stand above the others: modes, supervision, faults."""


@dataclass(frozen=True)
class Layout:
    """What there is to lay out.

    `lines` of the charts; `lanes`, `event_lanes`, `status_lanes` as `Message.Signal`; `figures` of the bus by
    kind, with the messages that have them; `probes` by process, name and unit each. `duration_s` is None
    while the recording goes on: time axes then follow the data. `surfaces` of the law by name, `load` the
    columns of the bus load with their highest values, `rules` rows and columns of the rule table.
    """

    lines: Sequence[ChartLine] = ()
    lanes: Sequence[str] = ()
    event_lanes: Sequence[str] = ()
    status_lanes: Sequence[str] = ()
    processes: Sequence[str] = ()
    figures: Mapping[str, Sequence[str]] = field(default_factory=dict)
    probes: Mapping[str, Sequence[tuple[str, str]]] = field(default_factory=dict)
    duration_s: float | None = None
    levels: Sequence[LevelLine] = ()
    line_map: bool = False
    surfaces: Sequence[str] = ()
    law_title: str = ""
    load: Mapping[str, float] = field(default_factory=dict)
    rules: tuple[int, int] | None = None
    lockstep: bool = False

    def on_page(self, page: str) -> list[Chart]:
        """Charts of a page in their order."""
        return [c for c in dict.fromkeys(line.chart for line in self.lines) if c.page == page]


@dataclass(frozen=True)
class _Line:
    """A line of a plot: the column that it shows, and its looks."""

    entity: str
    component: str
    name: str
    color: int
    width: float = 1.5
    step: bool = False


def build_blueprint(layout: Layout, *, active_tab: int = 0) -> rrb.Blueprint:
    """The finished dashboard for a layout."""
    tabs = [_drive(layout)]
    if layout.on_page("Law") or layout.surfaces:
        tabs.append(_law(layout))
    tabs += [_timing(layout), _bus(layout)]
    if layout.probes:
        tabs.append(_probes(layout))
    tabs.append(_events(layout))
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=active_tab),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline="sim_time",
            play_state="following" if layout.duration_s is None else "paused",
        ),
        auto_layout=False,
        auto_views=False,
    )


def _drive(layout: Layout) -> rrb.Container:
    charts = layout.on_page("Drive")
    columns: tuple[list[rrb.View], ...] = ([], [])
    shares: tuple[list[float], ...] = ([], [])
    for chart in charts:
        columns[chart.column].append(_chart(layout, chart))
        shares[chart.column].append(chart.share)
    left = rrb.Vertical(*columns[0], row_shares=shares[0])
    right = rrb.Vertical(*columns[1], _lanes(layout, "States", layout.lanes), row_shares=[*shares[1], 2.4])
    below = rrb.Horizontal(left, right, column_shares=[1.15, 1.0])
    drawings = [_drawing(layout, chart) for chart in charts if chart.distance]
    return rrb.Vertical(*drawings, below, row_shares=[*[1.0] * len(drawings), 1.8], name="Drive")


def _drawing(layout: Layout, chart: Chart) -> rrb.View:
    """The chart over distance, and the line with the train under it if there is one."""
    line = " · the line and the train on it" if layout.line_map else ""
    return rrb.Spatial2DView(
        origin="/over_distance" if layout.line_map else f"/over_distance/{chart.path}",
        name=f"{with_unit(chart.title, chart.unit)} over distance{line}",
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-0.04 * WIDTH, 1.01 * WIDTH),
            y_range=(-1.06 * HEIGHT, MAP_DEPTH if layout.line_map else 0.15 * HEIGHT),
        ),
    )


def _law(layout: Layout) -> rrb.Container:
    charts = [_chart(layout, chart) for chart in layout.on_page("Law")]
    surfaces = [
        rrb.Spatial2DView(
            origin=f"/law/{name}",
            name=f"{name.replace('_', ' ').capitalize()} by the rules; operating point",
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-0.14 * SURFACE, 1.05 * SURFACE), y_range=(-0.12 * SURFACE, 1.16 * SURFACE)
            ),
        )
        for name in layout.surfaces
    ]
    if not surfaces:
        return rrb.Vertical(*charts, name="Law")
    rows, columns = layout.rules or (1, 1)
    rules = rrb.Spatial2DView(
        origin="/law_rules",
        name=f"Rules that fire at the cursor; cells: {layout.surfaces[0].replace('_', ' ')}",
        visual_bounds=rrb.VisualBounds2D(x_range=(-1.2, columns + 0.3), y_range=(-1.0, rows + 0.2)),
    )
    pictures = [*surfaces, rules]
    grid = rrb.Vertical(*pictures) if len(pictures) < 3 else rrb.Grid(*pictures, grid_columns=2)
    return rrb.Horizontal(grid, rrb.Vertical(*charts), column_shares=[1.0, 1.35], name="Law")


def _timing(layout: Layout) -> rrb.Container:
    plots, shares = [], []
    if not layout.lockstep:
        plots.append(_plot(layout, "Wake-up latency [us]", _timing_lines(layout, ("wakeup_latency",))))
        shares.append(2.0)
    parts = ("read", "step", "encode", "send")
    for process in layout.processes:
        lines = [
            _Line(line.entity, line.component, part, color)
            for line, part, color in zip(
                _timing_lines(layout, parts, process), parts, (CYAN, ORANGE, VIOLET, GREEN), strict=True
            )
        ]
        plots.append(_plot(layout, f"Execution of {process} [us]", lines))
        shares.append(2.0)
    for chart in layout.on_page("Timing"):
        plots.append(_chart(layout, chart))
        shares.append(chart.share)
    kinds = [("execution", "Execution")]
    if not layout.lockstep:
        kinds.insert(0, ("wakeup_latency", "Wake-up latency"))
    bars = [
        rrb.BarChartView(
            origin=f"/histogram/{kind}",
            name=f"{title}: log10 of cycles over log10 of us (2 is 100 us, 3 is 1 ms); red: period",
        )
        for kind, title in kinds
    ]
    table = rrb.TextDocumentView(origin="/timing_summary", name="Percentiles")
    return rrb.Horizontal(
        rrb.Vertical(*plots, row_shares=shares),
        rrb.Vertical(*bars, table, row_shares=[*[3] * len(bars), 2]),
        column_shares=[1.5, 1.0],
        name="Timing",
    )


def _bus(layout: Layout) -> rrb.Container:
    loads = []
    shown = [name for name in layout.load if name.startswith(("load", "rate"))][-1:] or ["rate [kbit/s]"]
    for name in shown:
        line = _Line("/bus_statistics/load", component_name("load", name), name, BLUE)
        limits = (0.0, 1.3 * layout.load[name]) if layout.load.get(name) else None
        loads.append(_plot(layout, f"Bus load, each 100 ms: {name}", [line], limits=limits))
    titles = {
        "longest_interval": "Longest interval of each second, % of the cycle time",
        "shortest_interval": "Shortest interval of each second, % of the cycle time",
        "frames_per_second": "Frames per second",
    }
    errors = [
        _Line(
            "/bus_statistics/counter_errors",
            component_name("counter_errors", name),
            f"{name}: lost or repeated",
            color,
            2.0,
        )
        for name, color in zip(
            layout.figures.get("counter_errors", ()),
            [_message_colors(layout)[name] for name in layout.figures.get("counter_errors", ())],
            strict=True,
        )
    ]
    errors += [
        _Line(
            "/bus_statistics/interface", component_name("interface", name), f"interface: {name}", color, 2.0
        )
        for name, color in zip(layout.figures.get("interface", ()), (RED, LIMIT), strict=False)
    ]
    return rrb.Horizontal(
        rrb.Vertical(
            *loads,
            *(_figures(layout, title, kind) for kind, title in titles.items()),
            row_shares=[*[1.6] * len(loads), 2.0, 2.0, 2.6],
        ),
        rrb.Vertical(
            _lanes(layout, "E2E state of commands, node states", layout.status_lanes),
            _plot(layout, "So far: lost, repeated, dropped, error frames", errors),
            row_shares=[2.2, 1.0],
        ),
        column_shares=[1.2, 1.0],
        name="Bus",
    )


def _probes(layout: Layout) -> rrb.Container:
    views = []
    for process, probes in layout.probes.items():
        for unit in dict.fromkeys(unit for _, unit in probes):
            names = [name for name, its_unit in probes if its_unit == unit]
            lines = [
                _Line(f"/probe/{process}", component_name(process, with_unit(name, unit)), name, color)
                for name, color in zip(names, _probe_colors(names), strict=True)
            ]
            views.append(_plot(layout, with_unit(process, unit), lines))
    return rrb.Grid(*views, grid_columns=2 if len(views) < 7 else 3, name="Probes")


def _events(layout: Layout) -> rrb.Container:
    first = [lane for lane in layout.event_lanes if lane.rpartition(".")[2] in FIRST_LANES]
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.TextLogView(origin="/events", name="Events"),
            rrb.Horizontal(
                rrb.TextDocumentView(origin=VERDICT_DOCUMENT, name="Verdict"),
                rrb.TextDocumentView(origin=RUN_DOCUMENT, name="Run"),
            ),
            row_shares=[1.7, 1.0],
        ),
        rrb.Vertical(
            _lanes(layout, "Mode, supervision, faults, verdict", first, VERDICT_LANE),
            _lanes(layout, "All other states", [lane for lane in layout.event_lanes if lane not in first]),
            row_shares=[max(1, len(first) + 2), 14],
        ),
        name="Events",
    )


def _probe_colors(names: Sequence[str]) -> list[int]:
    """The colours of the same quantities elsewhere, others from what is left of the palette."""
    known = [probe_color(name) for name in names]
    if len(set(known) - {None}) < len([color for color in known if color]):  # two lines of one colour
        return list(colors(len(names)))
    free = iter(color for color in colors(len(names) + len(PALETTE)) if color not in known)
    return [next(free) if color is None else color for color in known]


def _chart(layout: Layout, chart: Chart) -> rrb.View:
    """A chart with its levels; what those are stands in the title, where it hides nothing."""
    levels = [level for level in layout.levels if level.chart == chart.path]
    both = {-level.value for level in levels if level.value < 0}
    title = with_unit(chart.title, chart.unit)
    for level in levels:
        if level.value >= 0:
            title += f" · {level.name} {'±' if level.value in both else ''}{level.value:g}"
    drawn = [_Line(each.entity, each.component, each.name, LIMIT, 2.0) for each in levels]
    series = [_chart_line(line) for line in layout.lines if line.chart == chart]
    return _plot(layout, title, [*drawn, *series], limits=chart.limits, legend=len(series) > 1)


def _chart_line(line: ChartLine) -> _Line:
    series = line.series
    return _Line(line.source.entity, line.component, series.name, series.color, series.width, series.step)


def _timing_lines(layout: Layout, columns: Sequence[str], process: str | None = None) -> list[_Line]:
    units = dict(TIMING_COLUMNS)
    return [
        _Line(
            f"/timing/{each}",
            component_name(TIMING_GROUP, with_unit(column, units[column])),
            each,
            PALETTE[place % len(PALETTE)],
        )
        for place, each in enumerate(layout.processes)
        if process in (None, each)
        for column in columns
    ]


def _plot(
    layout: Layout,
    name: str,
    lines: Sequence[_Line],
    *,
    limits: tuple[float, float] | None = None,
    legend: bool = True,
) -> rrb.View:
    """A plot of chosen columns. Peaks survive when many cycles fall into one pixel (MinMax)."""
    visualizers: dict[Any, list[rrb.Visualizer]] = {}  # by entity path
    for line in lines:
        style = rr.SeriesLines(
            names=line.name,
            colors=np.array([line.color], dtype=np.uint32),
            widths=line.width,
            aggregation_policy=rr.components.AggregationPolicy.MinMax,
            interpolation_mode=rr.components.InterpolationMode.StepAfter if line.step else None,
        )
        source = VisualizerComponentMapping(
            "Scalars:scalars", ComponentSourceKind.SourceComponent, source_component=line.component
        )
        visualizers.setdefault(line.entity, []).append(style.visualizer(mappings=[source]))
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(visualizers),
        overrides=visualizers,
        name=name,
        axis_x=_axis(layout),
        axis_y=None if limits is None else rrb.ScalarAxis(range=limits),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop, visible=legend),
    )


def _figures(layout: Layout, title: str, kind: str) -> rrb.View:
    """One kind of figure of all messages; while they are not known yet, whatever its entity holds."""
    entity, messages = f"/bus_statistics/{kind}", layout.figures.get(kind, ())
    if messages:
        tints = _message_colors(layout)
        lines = [_Line(entity, component_name(kind, name), name, tints[name], 2.0) for name in messages]
        return _plot(layout, title, lines, legend=kind == "frames_per_second")
    return rrb.TimeSeriesView(
        origin=entity, name=title, axis_x=_axis(layout), plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop)
    )


def _message_colors(layout: Layout) -> dict[str, int]:
    """A message has the same colour in all charts of the bus."""
    names = list(dict.fromkeys(name for kind in MESSAGE_FIGURES for name in layout.figures.get(kind, ())))
    return dict(zip(names, colors(len(names)), strict=True))


def _lanes(layout: Layout, name: str, signals: Sequence[str], *more: str) -> rrb.View:
    contents = [*more, *(f"/state/{signal.replace('.', '/')}" for signal in signals)]
    return rrb.StateTimelineView(origin="/state", contents=contents, name=name, time_view=_axis(layout))


def _axis(layout: Layout) -> rrb.TimeAxis | None:
    if layout.duration_s is None:
        return None
    boundary = rrb.TimeRangeBoundary.absolute
    whole = rrb.TimeRange(start=boundary(seconds=0.0), end=boundary(seconds=layout.duration_s))
    return rrb.TimeAxis(view_range=whole)
