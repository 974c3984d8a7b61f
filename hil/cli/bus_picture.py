"""The picture of `hil bus analyse`: every message's bound beside its deadline, on a logarithmic time axis."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from hil.canbus.analysis.message_set import NS_PER_MS
from hil.canbus.analysis.schedulability import Analysis

MEETS, MISSES, WIRE, DEADLINE = "#3b7d4f", "#c0392b", "#0b62a4", "#222222"
ROW_INCH = 0.27
TICKS_MS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)


def draw_bounds(found: Analysis, path: Path) -> None:
    """Bars: time on the wire within the response bound; a mark at each deadline. Most urgent on top."""
    count = len(found.verdicts)
    figure = Figure(figsize=(10.5, 1.9 + ROW_INCH * count), layout="constrained")
    axes = figure.subplots()
    known = [v.bound.response_ns or 0 for v in found.verdicts] + [
        v.message.deadline_ns for v in found.verdicts
    ]
    shortest = min(v.bound.stream.transmission_ns for v in found.verdicts) / NS_PER_MS
    left, right = 0.5 * shortest, 2.2 * max(known) / NS_PER_MS
    for row, verdict in enumerate(found.verdicts):
        bound = verdict.bound
        colour = MEETS if bound.meets else MISSES
        end = right if bound.response_ns is None else bound.response_ns / NS_PER_MS
        on_wire = bound.stream.transmission_ns / NS_PER_MS
        deadline = verdict.message.deadline_ns / NS_PER_MS
        hatch = "////" if bound.response_ns is None else None
        axes.barh(row, end - left, left=left, height=0.62, color=colour, alpha=0.9, hatch=hatch)
        axes.barh(row, on_wire - left, left=left, height=0.62, color=WIRE)
        axes.plot([deadline, deadline], [row - 0.42, row + 0.42], color=DEADLINE, linewidth=2.2)
        text = "no bound" if bound.response_ns is None else f"{end:.2f} ms"
        # Inside the bar: outside it would lie on the deadline.
        axes.annotate(
            text,
            (end, row),
            (-4, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=8,
            color="white",
            fontweight="bold",
        )
    axes.set_xscale("log")
    axes.set_xlim(left, right)
    axes.set_ylim(count - 0.4, -0.6)
    names = [
        f"{v.message.name}{' *' if v.message.assumption else ''}   0x{v.message.can_id:03X}"
        for v in found.verdicts
    ]
    axes.set_yticks(range(count), names, fontsize=8.5)
    ticks = [tick for tick in TICKS_MS if left <= tick <= right]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_xlabel("time since the message was due [ms], logarithmic")
    axes.grid(axis="x", alpha=0.25)
    axes.set_axisbelow(True)
    rate = f"{found.wire.bitrate / 1e3:g} kbit/s"
    if found.wire.data_bitrate is not None:
        rate += f" / {found.wire.data_bitrate / 1e3:g} kbit/s"
    late = sum(not verdict.bound.meets for verdict in found.verdicts)
    queue = "mailboxes" if found.queues.kind == "priority" else "fifo queues"
    outcome = "no message can miss its deadline" if not late else f"{late} of {count} can miss their deadline"
    axes.set_title(
        f"{found.messages.source} at {rate}, {queue}: {outcome}, load {found.worst_load:.1%} at worst",
        fontsize=11,
    )
    handles = [
        Patch(color=WIRE, label="longest frame"),
        Patch(color=MEETS, alpha=0.9, label="response bound, in time"),
        Patch(color=MISSES, alpha=0.9, label="response bound, can miss"),
        Line2D([], [], color=DEADLINE, linewidth=2.2, label="deadline"),
    ]
    if any(verdict.message.assumption for verdict in found.verdicts):
        handles.append(Line2D([], [], linestyle="", label="* event, interval assumed"))
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8.5
    )
    figure.savefig(path, dpi=130)
