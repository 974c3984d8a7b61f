"""timing.png: latency of all parts beside cyclictest, the control step split, limits drawn in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from hil.bench.timing.campaign import Campaign
from hil.bench.timing.limits import TimingLimits
from hil.bench.timing.request import FULL, FULL_ALONE, LOOP_PLAIN, LOOP_SPIN, PEER, TITLES
from hil.bench.timing.samples import Measured, spread

mpl.use("Agg")
from matplotlib.figure import Figure

__all__ = ["COLORS", "PICTURE_FILE", "draw"]

PICTURE_FILE = "timing.png"
COLORS = {
    LOOP_PLAIN: "#e69f00", LOOP_SPIN: "#56b4e9", FULL: "#0072b2", FULL_ALONE: "#cc79a7", PEER: "#8a8a8a",
}  # fmt: skip
SPAN_COLORS = ("#56b4e9", "#0072b2", "#e69f00", "#d55e00", "#009e73", "#cc79a7")
FLOOR_US = 0.1
"""What is shorter is drawn here: an axis of powers of ten has no zero."""


def draw(campaign: Campaign, limits: TimingLimits, folder: Path) -> Path:
    """Draw one row for each condition; returns the file."""
    conditions = list(dict.fromkeys(condition for condition, _ in campaign.measured))
    figure = Figure(figsize=(15.5, 4.9 * len(conditions) + 0.6), layout="constrained")
    axes = figure.subplots(len(conditions), 3, squeeze=False, width_ratios=(1.25, 1.25, 1.0))
    for row, condition in zip(axes, conditions, strict=True):
        parts = {part: known for (where, part), known in campaign.measured.items() if where == condition}
        _counts(row[0], parts)
        _exceedance(row[1], parts, limits)
        _execution(row[2], parts.get(FULL), limits)
        if len(conditions) > 1:
            row[0].annotate(
                {"idle": "as it was", "load": "every core busy"}[condition],
                (0, 1.1),
                weight="bold",
                xycoords="axes fraction",
                fontsize=12,
            )
    request = campaign.request
    scheduler = f"SCHED_FIFO {request.priority}" if campaign.fifo else "SCHED_OTHER (no real-time rights)"
    figure.suptitle(
        f"hil timing: period {request.period_s * 1e3:g} ms, {scheduler}, bus {request.bus.interface},"
        f" {campaign.host.kernel}, {campaign.host.cpus} CPUs"
        f"{'' if campaign.host.preempt_rt else ', no PREEMPT_RT'}",
        fontsize=11,
    )
    path = folder / PICTURE_FILE
    figure.savefig(path, dpi=110)
    return path


def _counts(axes: Any, parts: dict[str, Measured]) -> None:
    """Histograms over bins of equal ratio: cyclictest filled, ours as lines."""
    longest = max((float(np.max(known.wakeup_latency_us)) for known in parts.values()), default=1.0)
    edges = np.geomspace(FLOOR_US, max(1e3, 1.2 * longest), 90)
    for part, known in parts.items():
        # cyclictest counts whole microseconds: half of one puts them into the middle of what they stand for.
        shift = 0.5 if part == PEER else 0.0
        counts, _ = np.histogram(np.maximum(known.wakeup_latency_us + shift, FLOOR_US), edges)
        filled = part == PEER
        axes.stairs(
            counts,
            edges,
            fill=filled,
            color=COLORS[part],
            alpha=0.45 if filled else 1.0,
            linewidth=1.4,
            label=TITLES[part],
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="wake-up latency [µs]",
        ylabel="cycles",
        ylim=(0.7, None),
        title="Wake-up latency",
    )
    axes.legend(fontsize=8, loc="upper right")
    axes.grid(alpha=0.25)


def _exceedance(axes: Any, parts: dict[str, Measured], limits: TimingLimits) -> None:
    """Share of the cycles that woke up later than x; limits as marks at their percentile."""
    for part, known in parts.items():
        values = np.sort(np.maximum(known.wakeup_latency_us, FLOOR_US))
        share = 1.0 - np.arange(len(values)) / len(values)
        axes.step(values, share, where="post", color=COLORS[part], linewidth=2.2 if part == PEER else 1.4)
    peer = spread(parts[PEER].wakeup_latency_us) if PEER in parts else None
    ratios = limits.ratio_to_cyclictest
    if peer is not None:
        marks = (
            (LOOP_PLAIN, "plain_p99"),
            (FULL, "full_p99"),
            (FULL, "full_p999"),
            (LOOP_SPIN, "spin_p99"),
            (LOOP_SPIN, "spin_p999"),
        )
        for part, key in marks:
            limit = getattr(ratios, key)
            percentile = key.partition("_")[2]
            if limit is not None and part in parts:
                height = {"p99": 1e-2, "p999": 1e-3}[percentile]
                at = limit * getattr(peer, percentile)
                # The limits of node and loop coincide by default: two sizes, the small one on top.
                axes.plot(
                    [at],
                    [height],
                    marker="|",
                    markersize=26 if part == FULL else 14,
                    markeredgewidth=2.4,
                    color=COLORS[part],
                    linestyle="none",
                    zorder=5,
                )
    for height, name in ((1e-2, "p99"), (1e-3, "p99.9")):
        axes.axhline(height, color="black", linewidth=0.6, alpha=0.5)
        axes.annotate(
            name, (1.0, height), xycoords=("axes fraction", "data"), fontsize=8, ha="right", va="bottom"
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="wake-up latency [µs]",
        ylabel="share of cycles that are later",
        title="How often it is late; | = limit",
    )
    axes.grid(alpha=0.25)


def _execution(axes: Any, known: Measured | None, limits: TimingLimits) -> None:
    """The control step: how often each span and all together take longer than x, with the limits."""
    axes.set(title="Execution of the control step; | = limit")
    total = known.values("execution_us") if known is not None else np.empty(0)
    if known is None or not len(total):
        axes.text(0.5, 0.5, "not measured", ha="center", transform=axes.transAxes)
        return
    for color, (name, values) in zip(_cycled(SPAN_COLORS), known.spans_us().items(), strict=False):
        _late(axes, values, color, 1.2, name)
    _late(axes, total, "black", 2.0, "all")
    for percentile, height in (("p50", 0.5), ("p99", 1e-2), ("p999", 1e-3)):
        limit = getattr(limits.execution_us, percentile)
        if limit is not None:
            axes.plot([limit], [height], marker="|", markersize=20, markeredgewidth=2.4, color="black")
        axes.axhline(height, color="black", linewidth=0.6, alpha=0.5)
    axes.set(xscale="log", yscale="log", xlabel="time [µs]", ylabel="share of cycles that take longer")
    axes.legend(fontsize=8, loc="lower left")
    axes.grid(alpha=0.25)


def _late(axes: Any, values: NDArray[np.float64], color: str, width: float, label: str) -> None:
    ordered = np.sort(np.maximum(values, FLOOR_US))
    share = 1.0 - np.arange(len(ordered)) / len(ordered)
    axes.step(ordered, share, where="post", color=color, linewidth=width, label=label)


def _cycled(colors: Sequence[str]) -> Sequence[str]:
    return [*colors, *colors]
