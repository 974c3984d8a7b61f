"""What goes where in run.rrd: one entity per message, process, probe unit, state and chart.

/bus/<Message>                                all signals, Crc and Counter among them
/timing/<process>, /probe/<process>           cycles from the timing rings
/state/<Message>/<Signal>, /events/<node>     changes, as lanes and as text
/drive/<chart>/<series>, /over_distance/…     the dashboard's charts
/bus_statistics/…, /histogram/…, /timing_summary
"""

from __future__ import annotations

import json
import platform
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.record.about import DRAWN, RUN_DOCUMENT, host, own_version, run_table
from hil.record.blocks import Block, value_signals
from hil.record.blueprint import Layout, build_blueprint
from hil.record.bus_load import BusLoad
from hil.record.charts import MM_PER_M, Charts, Source, conversion
from hil.record.cycle_pages import CyclePages
from hil.record.dashboard import CYCLE, LANES, Chart, state_color
from hil.record.events import Event, EventDetector, is_state
from hil.record.law_page import LawPage, LawPicture
from hil.record.levels import Levels, known_levels
from hil.record.line_map import LineMap, Track
from hil.record.rerun_sink import RerunSink, with_unit
from hil.record.rings import Cycles, RingFeed
from hil.record.statistics import BusStatistics
from hil.record.timelines import ForwardFill, Instants, RecordingTime, find_signal

__all__ = ["Pages"]

NS_PER_S = 1e9
REDRAW_INTERVAL_S = 5.0
"""How often the drawings, histograms and tables are replaced while the run goes on."""

MakeSink = Callable[[rrb.Blueprint], RerunSink]


class Pages:
    """Writes blocks of frames and cycles to their entities, and keeps the dashboard up to date."""

    def __init__(
        self,
        contract: Contract,
        recording_time: RecordingTime,
        make_sink: MakeSink,
        *,
        charts: Sequence[Chart],
        position: str,
        processes: Sequence[str],
        properties: Mapping[str, Any] | None = None,
        lockstep: bool = False,
    ) -> None:
        signals = {
            f"{codec.name}.{signal.name}": Source(f"/bus/{codec.name}", codec.name, signal.name, signal.unit)
            for codec in contract.messages.values()
            for signal in value_signals(codec)
        }
        self.contract = contract
        self.statistics = BusStatistics(contract)
        self.interface_counters: Mapping[str, int] = {}
        properties = properties or {}
        bitrate = properties.get("bitrate")
        self._load = BusLoad(bitrate if isinstance(bitrate, int) else None)
        self._lockstep = lockstep
        self._properties = properties
        track, picture = Track.read(properties.get("track")), LawPicture.read(properties.get("law_picture"))
        self.events = 0
        self._time = recording_time
        self._processes = processes
        self._position_source = find_signal(position, contract) if position in signals else None
        self._position = ForwardFill()
        self._cycle = ForwardFill()
        self._start_ns: int | None = recording_time.start_ns
        self._last_ns = 0
        self._levels_begun = False
        self._detector = EventDetector(contract)
        self._figures: dict[str, dict[str, None]] = {}  # kind -> messages that have it, in order
        self._redrawn = time.monotonic()
        self._sink = make_sink(build_blueprint(Layout()))
        charts = [chart for chart in charts if not (lockstep and chart.realtime)]
        if picture is not None:
            charts += picture.charts
        self._charts = Charts(charts, self._sink)
        self._charts.offer(signals)
        self._levels = Levels(charts, known_levels(properties, contract), self._sink)
        self._law = None if picture is None else LawPage(picture, self._sink)
        self._line = None if track is None else LineMap(track, self._sink)
        self._cycle_pages = CyclePages(processes, self._charts, self._sink, self._law)
        self._sink.blueprint(build_blueprint(self._layout()))
        self._style_states()
        self._draw_once()
        if self._start_ns is not None:
            self._sink.start_time(self._start_ns)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last thing recorded, s."""
        return 0.0 if self._start_ns is None else max(0, self._last_ns - self._start_ns) / NS_PER_S

    def describe(self, properties: Mapping[str, Any]) -> None:
        """Attach what a reader needs to understand the recording without anything else."""
        shown = {key: value for key, value in properties.items() if isinstance(value, str | int | float)}
        about = {key: value for key, value in properties.items() if key not in DRAWN}
        self._sink.properties("run", {**shown, "json": json.dumps(about)})
        self._sink.properties("host", host())
        packages = ("rerun-sdk", "python-can", "cantools", "numpy")
        versions = {name.replace("-", "_"): version(name) for name in packages}
        versions = {"ato_hil": own_version(), "python": platform.python_version(), **versions}
        self._sink.properties("versions", versions)
        self._sink.document(RUN_DOCUMENT, run_table(shown, versions, host()))
        messages = {
            codec.name: {
                "can_id": codec.can_id,
                "sender": codec.sender,
                "signals": {signal.name: signal.unit for signal in codec.signals},
            }
            for codec in self.contract.messages.values()
        }
        dbc_text = self.contract.path.read_text(encoding="utf-8", errors="replace")
        about = {"file": self.contract.path.name, "dbc": dbc_text, "messages": json.dumps(messages)}
        self._sink.properties("contract", about)
        self._sink.flush()  # before any data: what is left of a cut file can be understood

    def write(
        self, block: Block, cycles: Sequence[tuple[RingFeed, Cycles]], frames: Sequence[Frame] = ()
    ) -> NDArray[np.int64]:
        """Write a block, made of these frames, and the new cycles of the rings; the frames' epoch ns."""
        times_ns = self._time.of_frames(block)
        timed = [(ring, new, self._time.of_cycles(new.scheduled_ns, ring.header)) for ring, new in cycles]
        self._begin([times_ns, *(times for _, _, times in timed)])
        self._learn_position(block, times_ns)
        if not self._processes:
            self._count_cycles(block, times_ns)
        for ring, new, times in timed:
            if ring.name == self._processes[0]:
                self._cycle.add(times, new.cycle)
        if len(block):
            self._write_messages(block, self._instants(times_ns))
            self._write_events(block, times_ns)
            self._write_statistics(block, times_ns)
            if len(frames):
                self._write_load(frames, block, times_ns)
        for ring, new, times in timed:
            self._write_cycles(ring, new, self._instants(times))
        if len(block) and not self._levels_begun:
            self._levels_begun = True
            self._levels.write(self._instants(times_ns[:1]))
        if time.monotonic() - self._redrawn > REDRAW_INTERVAL_S:
            self._redraw()
        return times_ns

    def close(self, summary: Mapping[str, Any]) -> None:
        """Draw what is drawn at the end, lay out the whole run, finish the file."""
        self._redraw()
        about = {"json": json.dumps(dict(summary)), "duration_s": self.duration_s}
        self._sink.properties("recording", about)
        self._sink.blueprint(self.dashboard())
        self._sink.close()

    def dashboard(self) -> rrb.Blueprint:
        """The dashboard of the whole run."""
        return build_blueprint(self._layout(finished=True))

    def _begin(self, times_ns: Sequence[NDArray[np.int64]]) -> None:
        known = [times for times in times_ns if len(times)]
        if not known:
            return
        if self._start_ns is None:
            self._start_ns = min(int(times[0]) for times in known)
            self._sink.start_time(self._start_ns)
        self._last_ns = max(self._last_ns, *(int(times[-1]) for times in known))

    def _learn_position(self, block: Block, times_ns: NDArray[np.int64]) -> None:
        source = self._position_source
        if source is not None and source.message in block.messages:
            message = block.messages[source.message]
            position_mm = message.column(source.name) * (source.si_factor * MM_PER_M)
            self._position.add(times_ns[message.rows], np.rint(position_mm).astype(np.int64))

    def _count_cycles(self, block: Block, times_ns: NDArray[np.int64]) -> None:
        message = block.messages.get(CYCLE)
        if message is not None:
            counts = np.arange(len(message.rows), dtype=np.int64) + self.statistics.heard[CYCLE].frames
            self._cycle.add(times_ns[message.rows], counts)

    def _instants(self, times_ns: NDArray[np.int64]) -> Instants:
        cycle = self._time.cycles(times_ns)
        if cycle is None:
            cycle = self._cycle.at(times_ns)
        return Instants(self._start_ns or 0, times_ns, cycle, self._position.at(times_ns))

    def _write_messages(self, block: Block, instants: Instants) -> None:
        for name, message in block.messages.items():
            places = instants.take(message.rows)
            columns: dict[str, NDArray[np.generic]] = {}
            for column, signal in zip(message.values.T, message.codec.signals, strict=True):
                if signal.role == "NONE":
                    columns[with_unit(signal.name, signal.unit)] = column
                    columns |= self._charts.take(f"{name}.{signal.name}", places, column)
                else:  # an integer: in tables, not in plots
                    columns[signal.name] = column.astype(np.uint8)
            self._sink.columns(f"/bus/{name}", name, places, columns)
            source = self._position_source
            if self._line is not None and source is not None and name == source.message:
                self._line.move(places, message.column(source.name) * source.si_factor)

    def _write_events(self, block: Block, times_ns: NDArray[np.int64]) -> None:
        events, changes = self._detector.scan(block, times_ns)
        self.events += len(events)
        by_source: dict[str, list[Event]] = defaultdict(list)
        for event in events:
            by_source[event.source or "bus"].append(event)
        for source, those in by_source.items():
            at = self._instants(np.array([event.time_ns for event in those], np.int64))
            texts, levels = [event.text for event in those], [event.level for event in those]
            self._sink.texts(f"/events/{source}", at, texts, levels)
        for change in changes:
            entity = f"/state/{change.message}/{change.signal.name}"
            self._sink.states(entity, self._instants(change.times_ns), change.states)

    def _write_load(self, frames: Sequence[Frame], block: Block, times_ns: NDArray[np.int64]) -> None:
        ends, columns = self._load.take(frames, block, times_ns)
        if len(ends):
            self._sink.columns("/bus_statistics/load", "load", self._instants(ends), columns)

    def _write_statistics(self, block: Block, times_ns: NDArray[np.int64]) -> None:
        for now_ns, row in self.statistics.take(block, times_ns):
            at = self._instants(np.array([now_ns], np.int64))
            counters = {name: float(value) for name, value in self.interface_counters.items()}
            for group, values in {**row, "interface": counters}.items():
                known = {name: np.array([value]) for name, value in values.items()}
                self._figures.setdefault(group, {}).update(dict.fromkeys(known))
                self._sink.columns(f"/bus_statistics/{group}", group, at, known)

    def _write_cycles(self, ring: RingFeed, cycles: Cycles, instants: Instants) -> None:
        if ring.name not in self._cycle_pages.headers:
            self._cycle_pages.introduce(ring.name, ring.header)
            self._sink.blueprint(build_blueprint(self._layout()))
            self._sink.flush()
        self._cycle_pages.write(ring.name, cycles, instants)

    def _redraw(self) -> None:
        self._redrawn = time.monotonic()
        self._charts.redraw()
        if self._law is not None:
            self._law.redraw()
        if self._start_ns is not None:
            self._levels.write(self._instants(np.array([self._last_ns], np.int64)))
        self._cycle_pages.redraw()

    def _layout(self, *, finished: bool = False) -> Layout:
        states = [
            f"{codec.name}.{signal.name}"
            for codec in self.contract.messages.values()
            for signal in codec.signals
            if is_state(signal)
        ]
        return Layout(
            lines=self._charts.lines,
            lanes=[lane for lane in LANES if lane in states],
            event_lanes=states,
            status_lanes=[lane for lane in states if lane.endswith(("NmtState", "CommandStatus"))],
            processes=self._processes,
            figures={kind: list(messages) for kind, messages in self._figures.items()} if finished else {},
            probes={
                name: [*header.probes, *self._cycle_pages.derived(name)]
                for name, header in self._cycle_pages.headers.items()
            },
            duration_s=self.duration_s if finished else None,
            levels=self._levels.lines,
            line_map=self._line is not None,
            surfaces=[] if self._law is None else [each.path for each in self._law.picture.surfaces],
            law_title="" if self._law is None else self._law.picture.title,
            load=self._load.peaks,
            rules=None if self._law is None else self._law.rules,
            lockstep=self._lockstep,
        )

    def _draw_once(self) -> None:
        """What does not move: the line, the surfaces of the law."""
        if self._line is not None:
            chart = next(iter(self._charts.distance.values()), None)
            factor = None if chart is None else conversion("m/s", chart.chart.unit)
            self._line.prepare(chart if factor else None, factor or 1.0)
            self._line.draw()
            self._charts.redraw()
        if self._law is not None:
            self._law.draw()

    def _style_states(self) -> None:
        """Names and colours of the states of the contract."""
        for codec in self.contract.messages.values():
            for signal in filter(is_state, codec.signals):
                states = list(signal.choices.values())
                shades = [state_color(state, k, signal.name) for k, state in enumerate(states)]
                self._sink.state_style(f"/state/{codec.name}/{signal.name}", states, shades)
