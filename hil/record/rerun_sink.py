"""run.rrd: columns to a Rerun recording, and to a live viewer if one was asked for."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image

from hil.record.timelines import Instants

__all__ = ["APPLICATION_ID", "RerunSink", "component_name", "with_unit"]

APPLICATION_ID = "ato_hil_bench"
"""One for all runs, so that the viewer lays out several of them alike."""

FLUSH_INTERVAL = timedelta(seconds=0.2)


class RerunSink:
    """Writes one recording. What a killed process leaves is readable up to the last `FLUSH_INTERVAL`.

    Only columns are sent, whole blocks of them: a row at a time would cost thirty times as much.
    """

    def __init__(
        self, path: Path, *, recording_id: str, name: str, blueprint: rrb.Blueprint, viewer_url: str | None
    ) -> None:
        self._recording = rr.RecordingStream(
            APPLICATION_ID,
            recording_id=recording_id,
            batcher_config=rr.ChunkBatcherConfig(flush_tick=FLUSH_INTERVAL),
        )
        # A footer names every piece, and they would wait for it in memory: megabytes a minute on a busy bus.
        # It comes when the pieces are joined (compact.py).
        file = rr.FileSink(path, write_footer=False)
        sinks = (file,) if viewer_url is None else (file, rr.GrpcSink(viewer_url))
        self._recording.set_sinks(*sinks, default_blueprint=blueprint)
        self._recording.set_log_time_enabled(False)
        self._recording.send_recording_name(name)
        self._styled: set[str] = set()

    def start_time(self, start_ns: int) -> None:
        """Say when the recording began, epoch ns."""
        self._recording.send_recording_start_time_nanos(start_ns)

    def blueprint(self, blueprint: rrb.Blueprint) -> None:
        """Replace the dashboard."""
        self._recording.send_blueprint(blueprint)

    def properties(self, name: str, values: Mapping[str, Any]) -> None:
        """Attach values to the recording, under this name."""
        self._recording.send_property(name, rr.AnyValues(**values))

    def columns(
        self, entity: str, group: str, instants: Instants, columns: Mapping[str, NDArray[np.generic]]
    ) -> None:
        """Send n rows of named columns, each (n); `component_name` says how a column is called then.

        Floating-point columns are plotted by the viewer when somebody drops the entity into a plot;
        integer ones are in tables only.
        """
        if columns and len(instants):
            data = rr.DynamicArchetype.columns(archetype=group, components=dict(columns))
            self._recording.send_columns(entity, _time_columns(instants), data)

    def texts(self, entity: str, instants: Instants, texts: Sequence[str], levels: Sequence[str]) -> None:
        """Send lines of an event log."""
        columns = rr.TextLog.columns(text=list(texts), level=list(levels))
        self._recording.send_columns(entity, _time_columns(instants), columns)

    def states(self, entity: str, instants: Instants, states: Sequence[str]) -> None:
        """Send new states of a lane."""
        columns = rr.StateChange.columns(state=list(states))
        self._recording.send_columns(entity, _time_columns(instants), columns)

    def state_style(self, entity: str, states: Sequence[str], colors: Sequence[int]) -> None:
        """Say how a lane's states are drawn."""
        style = rr.StateConfiguration(
            values=list(states), labels=list(states), colors=np.array(colors, dtype=np.uint32)
        )
        self._recording.log(entity, style, static=True)

    def bars(
        self,
        entity: str,
        heights: NDArray[np.float64],
        left: NDArray[np.float64],
        width: float,
        color: int,
    ) -> None:
        """Replace a bar chart; `left` (n) are the left edges of the bars."""
        widths = np.full(len(left), width, np.float32)
        self._recording.log(
            entity, rr.BarChart(heights, abscissa=left, widths=widths, color=color), static=True
        )

    def document(self, entity: str, markdown: str) -> None:
        """Replace a text in Markdown."""
        document = rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN)
        self._recording.log(entity, document, static=True)

    def drawing(
        self, entity: str, strips: Sequence[NDArray[np.float64]], color: int, width: float = 1.5
    ) -> None:
        """Replace lines of a plane drawing; each strip is (n, 2)."""
        lines = rr.LineStrips2D(
            list(strips), colors=np.array([color], dtype=np.uint32), radii=rr.Radius.ui_points(width / 2)
        )
        self._recording.log(entity, lines, static=True)

    def labels(self, entity: str, places: NDArray[np.float64], texts: Sequence[str], color: int) -> None:
        """Replace labels of a plane drawing; `places` is (n, 2)."""
        points = rr.Points2D(
            places,
            labels=list(texts),
            show_labels=True,
            colors=np.array([color] * len(places), dtype=np.uint32),
            radii=rr.Radius.ui_points(0.1),
        )
        self._recording.log(entity, points, static=True)

    def moving(
        self,
        entity: str,
        instants: Instants,
        strips: Sequence[NDArray[np.float64]],
        color: int,
        width: float,
    ) -> None:
        """Send n rows of one line of a plane drawing that moves; each strip is (m, 2)."""
        if entity not in self._styled:
            self._styled.add(entity)
            style = rr.LineStrips2D.from_fields(
                colors=np.array([color], dtype=np.uint32), radii=rr.Radius.ui_points(width / 2)
            )
            self._recording.log(entity, style, static=True)
        columns = rr.LineStrips2D.columns(strips=list(strips))
        self._recording.send_columns(entity, _time_columns(instants), columns)

    def moving_points(
        self, entity: str, instants: Instants, places: NDArray[np.float64], color: int, width: float
    ) -> None:
        """Send n rows of one point of a plane drawing that moves; `places` is (n, 2)."""
        if entity not in self._styled:
            self._styled.add(entity)
            style = rr.Points2D.from_fields(
                colors=np.array([color], dtype=np.uint32), radii=rr.Radius.ui_points(width), draw_order=50.0
            )
            self._recording.log(entity, style, static=True)
        columns = rr.Points2D.columns(positions=places)
        self._recording.send_columns(entity, _time_columns(instants), columns)

    def image(self, entity: str, pixels: NDArray[np.uint8], *, moves: bool = False) -> None:
        """Replace a picture, (height, width, 3); if it `moves`, only say how large its pictures are."""
        if moves:
            height, width = pixels.shape[:2]
            format_ = rr.components.ImageFormat(
                width=width, height=height, color_model="RGB", channel_datatype="U8"
            )
            self._recording.log(entity, rr.Image.from_fields(format=format_), static=True)
        else:
            encoded = io.BytesIO()
            Image.fromarray(pixels).save(encoded, format="PNG")
            picture = rr.EncodedImage(contents=encoded.getvalue(), media_type="image/png")
            self._recording.log(entity, picture, static=True)

    def moving_image(self, entity: str, instants: Instants, pixels: NDArray[np.uint8]) -> None:
        """Send n pictures, (n, height, width, 3), of the size that `image` has told."""
        columns = rr.Image.columns(buffer=[each.tobytes() for each in pixels])
        self._recording.send_columns(entity, _time_columns(instants), columns)

    def flush(self) -> None:
        """Hand everything to the file."""
        self._recording.flush(timeout_sec=10)

    def close(self) -> None:
        """Finish the file: with its footer it can be read without reading it all."""
        self._recording.disconnect()


def with_unit(name: str, unit: str) -> str:
    """Name of a column, and of its line in a plot: `Speed [km/h]`."""
    return f"{name} [{unit}]" if unit else name


def component_name(group: str, column: str) -> str:
    """What Rerun calls a column of `RerunSink.columns`."""
    return f"{group}:{column}"


def _time_columns(instants: Instants) -> list[rr.TimeColumn]:
    return [
        rr.TimeColumn("bus_time", timestamp=instants.bus_ns.astype("datetime64[ns]")),
        rr.TimeColumn("sim_time", duration=instants.since_start_ns.astype("timedelta64[ns]")),
        rr.TimeColumn("cycle", sequence=instants.cycle),
        rr.TimeColumn("position", sequence=instants.position_mm),
    ]
