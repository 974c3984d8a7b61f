"""Draws the figures of a study with matplotlib, one PNG each. Looks follow from what a line is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from studies.figure import Figure, Line, Panel, Role, thin

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["COLORS", "draw"]

COLORS: Mapping[Role, str] = MappingProxyType(
    {
        "reference": "#1a1a1a",
        "limit": "#d62f3a",
        "disturbance": "#8a8f98",
        "ideal": "#8a8f98",
        "a": "#1f6fd0",
        "b": "#e08214",
        "c": "#1a936a",
        "d": "#8750c9",
        "e": "#0b8a96",
    }
)
"""Reference black and dashed, limits red and dotted, ideal or disturbing grey, then one for each law."""

LOOKS: Mapping[Role, Mapping[str, Any]] = MappingProxyType(
    {
        "reference": {"linestyle": (0, (5, 2)), "linewidth": 1.3, "zorder": 5},
        "limit": {"linestyle": (0, (1, 1.5)), "linewidth": 1.4, "zorder": 4},
        "disturbance": {"linewidth": 1.0},
        "ideal": {"linestyle": (0, (3, 1, 1, 1)), "linewidth": 1.2, "zorder": 4},
    }
)

PANEL_SIZE_IN = (8.6, 2.7)
DPI = 130
MOST_POINTS = 4000


def draw(figures: tuple[Figure, ...], directory: Path, progress: Callable[[int], None]) -> list[Path]:
    """Write `<figure name>.png` for every figure; `progress` hears how many are done."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    files = []
    for done, figure in enumerate(figures):
        rows = -(-len(figure.panels) // figure.columns)
        width = PANEL_SIZE_IN[0] * (1.0 if figure.columns == 1 else 0.68 * figure.columns)
        canvas = Canvas(figsize=(width, PANEL_SIZE_IN[1] * rows + 0.7), layout="constrained", dpi=DPI)
        FigureCanvasAgg(canvas)
        axes = canvas.subplots(rows, figure.columns, squeeze=False).ravel()
        for place, panel in enumerate(figure.panels):
            _panel(axes[place], panel)
            if place >= len(figure.panels) - figure.columns:
                axes[place].set_xlabel(figure.x_label)
        for unused in axes[len(figure.panels) :]:
            unused.set_visible(False)
        beside = f"   (paper: {figure.paper})" if figure.paper else ""
        canvas.suptitle(figure.title + beside, fontsize=11, fontweight="bold", x=0.01, ha="left")
        files.append(directory / f"{figure.name}.png")
        canvas.savefig(files[-1])
        progress(done + 1)
    return files


def _panel(axes: Axes, panel: Panel) -> None:
    for line in panel.lines:
        x, y = _visible(line, panel)
        look = {"linewidth": 1.3} | dict(LOOKS.get(line.role, {}))
        style = "steps-post" if line.step else "default"
        axes.plot(x, y, color=COLORS[line.role], label=line.label, drawstyle=style, **look)
    axes.set_title(panel.title, fontsize=9.5, loc="left")
    axes.set_ylabel(panel.y_label)
    axes.grid(color="#dcdfe3", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.margins(x=0.01)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8.5)
    if panel.log_y:
        axes.set_yscale("log")
    if panel.x_limits is not None:
        axes.set_xlim(*panel.x_limits)
    if panel.y_limits is not None:
        axes.set_ylim(*panel.y_limits)
    if len(panel.lines) > 1:
        axes.legend(fontsize=8, loc="best", framealpha=0.9)


def _visible(line: Line, panel: Panel) -> tuple[Any, Any]:
    """What lies within the panel, thinned: outside points would only blur what can be seen."""
    if panel.x_limits is None:
        return thin(line.x, line.y, MOST_POINTS)
    low, high = panel.x_limits
    inside = (line.x >= low) & (line.x <= high)
    # One point more on each side, or the line would end short of the frame.
    inside[:-1] |= inside[1:]
    inside[1:] |= inside[:-1]
    return thin(line.x[inside], line.y[inside], MOST_POINTS)
