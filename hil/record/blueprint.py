"""The dashboard: how the viewer lays out a recording when it opens it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from hil.record.charts import ChartLine
from hil.record.cycle_pages import TIMING_GROUP
from hil.record.dashboard import PALETTE, colors
from hil.record.distance import HEIGHT, WIDTH
from hil.record.rerun_sink import component_name, with_unit
from hil.record.rings import TIMING_COLUMNS

__all__ = ["TABS", "Layout", "build_blueprint"]

TABS = ("Drive", "Timing", "Bus", "Probes", "Events")
"""The tabs in their order; `Probes` is left out when no process has any."""


@dataclass(frozen=True)
class Layout:
    """What there is to lay out.

    `lines` of the charts; `lanes`, `event_lanes`, `status_lanes` as `Message.Signal`; `figures` of the bus by
    kind, with the messages that have them; `probes` by process, name and unit each. `duration_s` is None
    while the recording goes on: time axes then follow the data.
    """

    lines: Sequence[ChartLine] = ()
    lanes: Sequence[str] = ()
    event_lanes: Sequence[str] = ()
    status_lanes: Sequence[str] = ()
    processes: Sequence[str] = ()
    figures: Mapping[str, Sequence[str]] = field(default_factory=dict)
    probes: Mapping[str, Sequence[tuple[str, str]]] = field(default_factory=dict)
    duration_s: float | None = None


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
    tabs = [_drive(layout), _timing(layout), _bus(layout)]
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
    charts = list(dict.fromkeys(line.chart for line in layout.lines))
    columns: tuple[list[rrb.View], ...] = ([], [])
    shares: tuple[list[float], ...] = ([], [])
    for chart in charts:
        lines = [_chart_line(line) for line in layout.lines if line.chart == chart]
        name = with_unit(chart.title, chart.unit)
        columns[chart.column].append(_plot(layout, name, lines, limits=chart.limits))
        shares[chart.column].append(chart.share)
    drawings = [
        rrb.Spatial2DView(
            origin=f"/over_distance/{chart.path}",
            name=f"{with_unit(chart.title, chart.unit)} over distance",
            visual_bounds=rrb.VisualBounds2D(
                x_range=(-0.08 * WIDTH, 1.03 * WIDTH), y_range=(-1.12 * HEIGHT, 0.15 * HEIGHT)
            ),
        )
        for chart in charts
        if chart.distance
    ]
    left = rrb.Vertical(*columns[0], row_shares=shares[0])
    right = rrb.Vertical(
        *drawings,
        *columns[1],
        _lanes(layout, "States", layout.lanes),
        row_shares=[*[3.4] * len(drawings), *shares[1], 2.8],
    )
    return rrb.Horizontal(left, right, column_shares=[1.2, 1.0], name="Drive")


def _timing(layout: Layout) -> rrb.Container:
    plots = [
        _plot(layout, title, _timing_lines(layout, columns, step=step))
        for title, columns, step in (
            ("Wake-up latency [us]", ("wakeup_latency",), False),
            ("Execution: read, step, send [us]", ("read", "step", "send"), False),
            ("Period error [us]", ("period_error",), False),
            ("Missed cycles so far", ("missed",), True),
        )
    ]
    bars = [
        rrb.BarChartView(
            origin=f"/histogram/{kind}", name=f"{title} [us]: log10(1 + cycles); last bar: and longer"
        )
        for kind, title in (("wakeup_latency", "Wake-up latency"), ("execution", "Execution time"))
    ]
    table = rrb.TextDocumentView(origin="/timing_summary", name="Percentiles")
    return rrb.Horizontal(
        rrb.Vertical(*plots, row_shares=[3, 3, 3, 1.5]),
        rrb.Vertical(*bars, table, row_shares=[3, 3, 2.5]),
        column_shares=[1.5, 1.0],
        name="Timing",
    )


def _bus(layout: Layout) -> rrb.Container:
    titles = {
        "frames_per_second": "Frames per second",
        "interval_excess_ms": "Longest interval minus cycle time, each second [ms]",
        "counter_errors": "Frames lost or repeated so far, by counter",
    }
    return rrb.Horizontal(
        rrb.Vertical(
            *(_figures(layout, title, kind) for kind, title in titles.items()), row_shares=[2, 2, 1]
        ),
        _lanes(layout, "Node and command states", layout.status_lanes),
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
                for name, color in zip(names, colors(len(names)), strict=True)
            ]
            views.append(_plot(layout, with_unit(process, unit), lines))
    return rrb.Grid(*views, grid_columns=2 if len(views) < 7 else 3, name="Probes")


def _events(layout: Layout) -> rrb.Container:
    return rrb.Horizontal(
        rrb.TextLogView(origin="/events", name="Events"),
        _lanes(layout, "All states", layout.event_lanes),
        name="Events",
    )


def _chart_line(line: ChartLine) -> _Line:
    series = line.series
    return _Line(line.source.entity, line.component, series.name, series.color, series.width, series.step)


def _timing_lines(layout: Layout, columns: Sequence[str], *, step: bool) -> list[_Line]:
    units = dict(TIMING_COLUMNS)
    return [
        _Line(
            f"/timing/{process}",
            component_name(TIMING_GROUP, with_unit(column, units[column])),
            f"{process} {column}" if len(columns) > 1 else process,
            PALETTE[(place + 2 * k) % len(PALETTE)],
            step=step,
        )
        for place, process in enumerate(layout.processes)
        for k, column in enumerate(columns)
    ]


def _plot(
    layout: Layout, name: str, lines: Sequence[_Line], *, limits: tuple[float, float] | None = None
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
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop),
    )


def _figures(layout: Layout, title: str, kind: str) -> rrb.View:
    """One kind of figure of all messages; while they are not known yet, whatever its entity holds."""
    entity, messages = f"/bus_statistics/{kind}", layout.figures.get(kind, ())
    if messages:
        tints = zip(messages, colors(len(messages)), strict=True)
        lines = [_Line(entity, component_name(kind, name), name, color, 2.0) for name, color in tints]
        return _plot(layout, title, lines)
    return rrb.TimeSeriesView(
        origin=entity, name=title, axis_x=_axis(layout), plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop)
    )


def _lanes(layout: Layout, name: str, signals: Sequence[str]) -> rrb.View:
    contents = [f"/state/{signal.replace('.', '/')}" for signal in signals]
    return rrb.StateTimelineView(origin="/state", contents=contents, name=name, time_view=_axis(layout))


def _axis(layout: Layout) -> rrb.TimeAxis | None:
    if layout.duration_s is None:
        return None
    boundary = rrb.TimeRangeBoundary.absolute
    whole = rrb.TimeRange(start=boundary(seconds=0.0), end=boundary(seconds=layout.duration_s))
    return rrb.TimeAxis(view_range=whole)
