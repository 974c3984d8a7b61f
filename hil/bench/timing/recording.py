"""timing.rrd: the histograms and the course of the control node's cycles, for the Rerun viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hil.bench.timing.campaign import Campaign
from hil.bench.timing.request import FULL, FULL_ALONE, PEER, TITLES
from hil.bench.timing.samples import Measured, spread

__all__ = ["RECORDING_FILE", "record"]

RECORDING_FILE = "timing.rrd"
APPLICATION_ID = "ato_hil_timing"
BARS = 80
COLORS = {"loop_plain": 0xE69F00FF, "loop_spin": 0x56B4E9FF, FULL: 0x0072B2FF, FULL_ALONE: 0xCC79A7FF,
          PEER: 0x9A9A9AFF}  # fmt: skip
CONDITIONS = {"idle": "as it was", "load": "every core busy"}


def record(campaign: Campaign, folder: Path, table: str) -> Path:
    """Write the recording, with `table` (Markdown); returns the file."""
    path = folder / RECORDING_FILE
    recording = rr.RecordingStream(APPLICATION_ID)
    recording.set_sinks(rr.FileSink(path, write_footer=True), default_blueprint=_blueprint(campaign))
    recording.set_log_time_enabled(False)
    recording.send_recording_name(f"timing, {campaign.request.period_s * 1e3:g} ms")
    recording.log("table", rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN), static=True)
    for condition in campaign.request.conditions:
        parts = {part: known for (where, part), known in campaign.measured.items() if where == condition}
        _bars(recording, condition, parts)
        if FULL in parts:
            _course(recording, condition, parts[FULL])
    recording.flush(timeout_sec=10)
    recording.disconnect()
    return path


def _bars(recording: rr.RecordingStream, condition: str, parts: dict[str, Measured]) -> None:
    """log10(1 + cycles) over latency, the parts side by side in each bin; what is longer is in the last bin.

    The axis ends at twice the longest 99.9th percentile: one stall shall not squeeze all others into a bar.
    """
    tails = [known.p999 for known in (spread(part.wakeup_latency_us) for part in parts.values()) if known]
    width_us = max(1.0, float(np.ceil(2 * max(tails, default=1.0) / BARS)))
    share = width_us / max(1, len(parts))
    for place, (part, known) in enumerate(parts.items()):
        bins = np.clip(known.wakeup_latency_us // width_us, 0, BARS - 1).astype(np.int64)
        heights = np.log10(1.0 + np.bincount(bins, minlength=BARS))
        left = np.arange(BARS) * width_us + place * share
        recording.log(
            f"histogram/{condition}/{part}",
            rr.BarChart(heights, abscissa=left, widths=np.full(BARS, share, np.float32), color=COLORS[part]),
            static=True,
        )


def _course(recording: rr.RecordingStream, condition: str, known: Measured) -> None:
    """Latency and execution of every cycle; the slices follow each other without what lay between them."""
    lines = {
        "latency": ("wakeup_latency_us", "wake-up latency", COLORS[FULL]),
        "execution": ("execution_us", "execution", 0xD55E00FF),
    }
    for entity, (name, title, color) in lines.items():
        path = f"{entity}/{condition}"
        recording.log(path, rr.SeriesLines(colors=[color], names=[title], widths=[1.0]), static=True)
        before = 0.0
        for piece in known.slices:
            values: NDArray[np.float64] = getattr(piece, name)
            time_s = (piece.series_ns - piece.series_ns[0]) * 1e-9 + before
            before = float(time_s[-1]) + 0.1
            column = rr.TimeColumn("time", duration=time_s)
            recording.send_columns(path, [column], rr.Scalars.columns(scalars=values))


def _blueprint(campaign: Campaign) -> rrb.Blueprint:
    rows = []
    for condition in campaign.request.conditions:
        suffix = f", {CONDITIONS[condition]}" if len(campaign.request.conditions) > 1 else ""
        names = ", ".join(TITLES[part] for where, part in campaign.measured if where == condition)
        rows.append(
            rrb.Horizontal(
                rrb.BarChartView(
                    origin=f"/histogram/{condition}",
                    name=f"Wake-up latency [us], log10(1 + cycles){suffix}: {names}",
                ),
                rrb.Vertical(
                    rrb.TimeSeriesView(origin=f"/latency/{condition}", name=f"Wake-up latency [us]{suffix}"),
                    rrb.TimeSeriesView(origin=f"/execution/{condition}", name=f"Execution [us]{suffix}"),
                ),
            )
        )
    return rrb.Blueprint(
        rrb.Tabs(rrb.Vertical(*rows, name="Timing"), rrb.TextDocumentView(origin="/table", name="Table")),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
