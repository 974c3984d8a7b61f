"""compare.png: speed, error and effort of the nominal runs over distance, and the stop errors of all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.bench.compare import Comparison
from hil.bench.contender import Contender
from hil.bench.trial import Lines, TrialResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE_FILE = "compare.png"
COLORS = ("#1f6fd0", "#e08214", "#1a936a", "#8750c9", "#c2284b", "#0b8a96", "#8a6d1b", "#5a6472")
GRID = "#dcdfe3"
SMALLEST_M = 5e-4
"""The axis of stop errors is logarithmic: what is below half a millimetre is drawn there."""
WIDE = 8.0
"""An axis of errors is logarithmic outside its middle when the worst is so many times a good one."""
MARKS_M = {"spec": 0.1, "full": 0.25}
"""What is asked for: within 0.10 m over the spec set, within 0.25 m over the full one."""


def colors(contenders: Sequence[Contender]) -> dict[str, str]:
    """A colour for each contender; a law and its presets share one."""
    laws = list(dict.fromkeys(contender.law for contender in contenders))
    return {contender.name: COLORS[laws.index(contender.law) % len(COLORS)] for contender in contenders}


def draw_picture(comparison: Comparison, folder: Path) -> Path | None:
    """Write the picture; None if no run came far enough to show anything."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = {
        name: result.lines
        for name, result in comparison.nominal.items()
        if result.lines is not None and len(result.lines.time_s) > 1
    }
    drawn = {name: results for name, results in comparison.drawn.items() if results}
    if not shown and not drawn:
        return None
    heights = [2.6, 1.9, 1.9, *([2.6] if drawn else [])]
    figure = Figure(figsize=(10.5, sum(heights) + 0.6), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False).ravel().tolist()
    for panel in panels:
        panel.grid(color=GRID, linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8.5)
    _over_distance(panels[:3], shown, _looks(comparison.request.contenders))
    if drawn:
        _stops(panels[3], drawn, comparison)
    title = f"{comparison.request.scenario}: nominal runs"
    figure.suptitle(title, fontsize=11, fontweight="bold", x=0.01, ha="left")
    path = folder / PICTURE_FILE
    figure.savefig(path)
    return path


def _looks(contenders: Sequence[Contender]) -> dict[str, dict[str, Any]]:
    chosen = colors(contenders)
    return {
        contender.name: {
            "color": chosen[contender.name],
            "linestyle": "-" if contender.preset is None else (0, (4, 1.5)),
            "linewidth": 1.2 if contender.preset is None else 0.8,
            "alpha": 1.0 if contender.preset is None else 0.6,
            "zorder": 3 if contender.preset is None else 2,
            "label": contender.name,
        }
        for contender in contenders
    }


def _over_distance(
    panels: Sequence[Axes], shown: Mapping[str, Lines], looks: Mapping[str, Mapping[str, Any]]
) -> None:
    speed, error, effort = panels
    speed.set_ylabel("speed [km/h]")
    error.set_ylabel("speed error [m/s]\nreference - true")
    for name, lines in shown.items():
        speed.plot(lines.position_m, lines.speed_mps * 3.6, **looks[name])
        error.plot(lines.position_m, lines.error_mps, **looks[name])
        effort.plot(lines.position_m, lines.effort_n * 1e-3, **{**looks[name], "linewidth": 0.9})
    if shown:
        first = next(iter(shown.values()))
        speed.plot(
            first.position_m, first.reference_speed_mps * 3.6,
            color="#1a1a1a", linestyle=(0, (5, 2)), linewidth=1.1, label="reference", zorder=5,
        )  # fmt: skip
        speed.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=8, frameon=False)
        _fit_error_axis(error, [lines.error_mps for lines in shown.values()])
    effort.set_ylabel("commanded effort [kN]")
    effort.set_xlabel("position [m]")


def _fit_error_axis(panel: Axes, errors: Sequence[np.ndarray[Any, Any]]) -> None:
    """Where one law is ten times worse than another, the better ones would be a line: logarithmic outside."""
    worst = sorted(float(np.max(np.abs(error))) for error in errors)
    good = worst[len(worst) // 4]
    if worst[-1] > WIDE * good > 0.0:
        panel.set_yscale("symlog", linthresh=good)
        panel.set_ylabel("speed error [m/s]\n(logarithmic outside)")
        panel.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _stops(panel: Axes, drawn: Mapping[str, Sequence[TrialResult]], comparison: Comparison) -> None:
    request = comparison.request
    looks = _looks(request.contenders)
    random = np.random.default_rng(0)  # only to keep points from hiding each other
    names = [contender.name for contender in request.contenders if contender.name in drawn]
    labels = []
    for place, name in enumerate(names):
        results = drawn[name]
        known = [abs(r.metrics.stop_error_m) for r in results if r.metrics.stop_error_m is not None]
        stops = np.maximum(known, SMALLEST_M)
        color = looks[name]["color"]
        panel.scatter(
            place + random.uniform(-0.28, 0.28, len(stops)), stops, s=9, color=color, alpha=0.5, linewidths=0
        )
        if len(stops) >= 5:
            panel.boxplot(
                [stops], positions=[place], widths=0.62, whis=(0, 95), showfliers=False,
                medianprops={"color": "#1a1a1a"}, boxprops={"color": color}, whiskerprops={"color": color},
                capprops={"color": color},
            )  # fmt: skip
        failed = sum(bool(result.failure) for result in results)
        labels.append(name + (f"\n{failed} of {len(results)} failed" if failed else ""))
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    for mark in filter(None, [MARKS_M.get(request.set_name)]):
        panel.axhline(mark, color="#d62f3a", linestyle=(0, (1, 1.5)), linewidth=1.2)
        panel.text(
            len(names) - 0.5, mark, f" {mark:g} m", color="#d62f3a", fontsize=8, va="bottom", ha="right"
        )
    panel.set_xticks(range(len(names)), labels, fontsize=8.5)
    panel.set_xlim(-0.6, len(names) - 0.4)
    panel.set_ylabel("|stop error| [m]")
    panel.set_title(
        f"{_counts(drawn)} runs of the {request.set_name} set each, seed {request.seed}"
        " (box: quartiles, whisker: 95 %)",
        fontsize=9.5,
        loc="left",
    )


def _counts(drawn: Mapping[str, Sequence[TrialResult]]) -> str:
    """How many runs there are of each; they differ where the user stopped in between."""
    counts = sorted({len(results) for results in drawn.values()})
    return " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
