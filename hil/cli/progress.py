"""The live display of a run: the train on its line, its speed beside reference and limit, mode, next stop.

On a terminal a picture of four lines, ten times a second at most; in a pipe a line every few seconds.
"""

from __future__ import annotations

import time
from collections import deque
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from hil.bench.scenario import Scenario
from hil.bench.watch import View
from hil.cli.gauges import Strip, gauge, sparkline

PLAIN_EVERY_S = 5.0
"""Without a terminal (a pipe, a CI log): one line this often."""

PICTURE_EVERY_S = 0.1
KMH = 3.6
WIDEST, NARROWEST = 100, 50
HISTORY = 16
"""Pictures whose speed error is kept for the sparkline."""

MODES = {
    "RUN": "bold green",
    "STOPPING": "bold cyan",
    "HOLD": "bold green",
    "DEGRADED": "bold yellow",
    "EMERGENCY": "bold red",
}


class Progress:
    """Shows a run while it goes; a context manager. Never more than ten pictures a second."""

    def __init__(self, scenario: Scenario, *, console: Console, quiet: bool = False) -> None:
        self._scenario = scenario
        self._console = console
        self._quiet = quiet
        self._live = (
            Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        )
        self._last = 0.0
        line = scenario.journey.line
        self._fastest_mps = max([limit.limit_mps for limit in line.speed_limits] or [line.default_limit_mps])
        self._errors: deque[float] = deque(maxlen=HISTORY)

    def __enter__(self) -> Progress:
        if self._live is not None and not self._quiet:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None and not self._quiet:
            self._live.stop()

    def show(self, view: View, *, speedup: float | None = None) -> None:
        """Show the train as last heard."""
        now = time.monotonic()
        interval = PICTURE_EVERY_S if self._live is not None else PLAIN_EVERY_S
        if self._quiet or now - self._last < interval:
            return
        self._last = now
        if self._live is not None:
            self._live.update(self.picture(view, speedup), refresh=True)
        else:
            self._console.print(self.line(view, speedup), highlight=False, soft_wrap=True)

    def line(self, view: View, speedup: float | None = None) -> str:
        """The train in one line of plain text."""
        limit = view.permitted_speed_mps
        parts = [
            f"t {view.time_s:6.1f} s",
            f"x {view.position_m:9.2f} m",
            f"v {view.speed_mps * KMH:6.2f} km/h",
            f"reference {view.reference_speed_mps * KMH:6.2f} km/h",
            "" if limit is None else f"limit {limit * KMH:5.1f} km/h",
            view.mode,
            "" if view.supervision in ("NORMAL", "-") else view.supervision,
            f"misses {view.deadline_misses}" if speedup is None and view.deadline_misses else "",
            f"{speedup:.0f}x real time" if speedup else "",
        ]
        return "  ".join(part for part in parts if part)

    def picture(self, view: View, speedup: float | None = None) -> RenderableType:
        """The train as four lines, as wide as the terminal allows."""
        self._errors.append((view.reference_speed_mps - view.speed_mps) * KMH)
        width = min(max(self._console.width - 1, NARROWEST), WIDEST)
        journey = self._scenario.journey
        names = journey.origin.name, journey.destination.name
        strip = Strip(journey, width - sum(len(name) + 1 for name in names))
        indent = " " * (len(names[0]) + 1)
        line = Text.assemble((names[0], "bold"), " ", strip.track(view.position_m), " ", (names[1], "bold"))
        return Group(
            Text.assemble(indent, strip.limits(view.position_m)),
            line,
            self._speeds(view, width),
            self._facts(view, speedup),
        )

    def _speeds(self, view: View, width: int) -> Text:
        limit, reference = view.permitted_speed_mps, view.reference_speed_mps
        words = Text.assemble(
            (f"{view.speed_mps * KMH:6.2f} km/h", "bold"),
            f"  ref {reference * KMH:6.2f}",
            "" if limit is None else f"  limit {limit * KMH:5.1f}",
        )
        errors = Text.assemble("  ref-v ", (sparkline(self._errors), "magenta"))
        room = width - words.cell_len - errors.cell_len - 2
        if room >= 8:
            words.append("  ")
            words.append_text(gauge(view.speed_mps, reference, limit, full=self._fastest_mps, width=room))
        return words.append_text(errors)

    def _facts(self, view: View, speedup: float | None) -> Text:
        stop = self._scenario.journey.destination.name
        missed = view.deadline_misses
        return Text.assemble(
            (view.mode, MODES.get(view.mode, "dim")),
            "" if view.supervision in ("NORMAL", "-") else (f" {view.supervision}", "yellow"),
            f"  {stop} in {view.distance_to_stop_m:.1f} m  t {view.time_s:.1f} s  ",
            ("" if speedup else f"misses {missed}", "red" if missed else "dim"),
            f"{speedup:.0f}x real time" if speedup else "",
            overflow="ellipsis",
            no_wrap=True,
        )
