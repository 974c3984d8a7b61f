"""replay.png: the signals that deviate most, recorded and replayed, and their difference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.replay.comparison import SignalResult
from hil.bench.replay.job import Replayed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["PICTURE_FILE", "draw_picture"]

PICTURE_FILE = "replay.png"
MOST_SIGNALS = 4
RECORDED, REPLAYED, DIFFERENCE = "#5a6472", "#1f6fd0", "#c2284b"
GRID = "#dcdfe3"


def draw_picture(replayed: Replayed, folder: Path) -> Path | None:
    """Write the picture; None if nothing deviates. Raises OSError when the folder does not take it."""
    worst = replayed.comparison.worst(MOST_SIGNALS)
    if not worst:
        return None
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 3.6 * len(worst) + 0.6), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2 * len(worst), 1, height_ratios=[2.0, 1.2] * len(worst), sharex=True)
    for panel in panels:
        panel.grid(color=GRID, linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        panel.tick_params(labelsize=8.5)
    for number, signal in enumerate(worst):
        _values(panels[2 * number], signal)
        _difference(panels[2 * number + 1], signal)
    panels[0].legend(loc="upper right", fontsize=8.5, frameon=False, ncols=2)
    panels[-1].set_xlabel("time since the start of the log [s]", fontsize=9)
    what = "the signal that deviates" if len(worst) == 1 else f"{len(worst)} signals that deviate most"
    figure.suptitle(f"{replayed.node} replayed: {replayed.title}, {what}", fontsize=11)
    path = folder / PICTURE_FILE
    figure.savefig(path)
    return path


def _values(panel: Axes, signal: SignalResult) -> None:
    """Both courses; what was recorded is broad, so that it is seen below a replay that is equal."""
    panel.step(
        signal.time_s, signal.recorded, where="post", color=RECORDED, linewidth=2.6, alpha=0.5,
        label="recorded",
    )  # fmt: skip
    panel.step(signal.time_s, signal.replayed, where="post", color=REPLAYED, linewidth=1.1, label="replayed")
    panel.set_title(signal.name, loc="left", fontsize=9.5)
    panel.set_ylabel(_unit(signal), fontsize=9)
    words = signal.signal.choices
    if words:
        seen = sorted({int(value) for value in np.concatenate([signal.recorded, signal.replayed])})
        panel.set_yticks(seen, [str(words.get(value, value)) for value in seen])


def _difference(panel: Axes, signal: SignalResult) -> None:
    exact = not signal.tolerance
    difference = signal.replayed - signal.recorded
    if exact:  # between two states there is no distance
        difference = (difference != 0.0).astype(np.float64)
    panel.step(signal.time_s, difference, where="post", color=DIFFERENCE, linewidth=1.0)
    if exact:
        panel.set_yticks([0.0, 1.0], ["same", "differs"])
        panel.set_ylim(-0.15, 1.4)
    else:
        panel.axhspan(-signal.tolerance, signal.tolerance, color=RECORDED, alpha=0.22, linewidth=0)
        panel.set_ylabel(f"difference {_unit(signal)}", fontsize=9)
    if signal.first is not None:
        panel.axvline(signal.first.time_s, color=RECORDED, linewidth=0.9, linestyle=":")
        panel.annotate(
            f"first beyond the tolerance: {signal.first.time_s:.2f} s",
            (signal.first.time_s, 1.0), xycoords=("data", "axes fraction"),
            xytext=(4, -2), textcoords="offset points", va="top", fontsize=8, color=RECORDED,
        )  # fmt: skip


def _unit(signal: SignalResult) -> str:
    return f"[{signal.signal.unit}]" if signal.signal.unit else ""
