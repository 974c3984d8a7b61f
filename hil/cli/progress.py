"""The live display of a run: where the train is, how fast, how fast it should be, in which mode."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from hil.bench.scenario import Scenario
from hil.bench.watch import View

PLAIN_EVERY_S = 5.0
"""Without a terminal (a pipe, a CI log): one line this often."""


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
        interval = 0.1 if self._live is not None else PLAIN_EVERY_S
        if self._quiet or now - self._last < interval:
            return
        self._last = now
        if self._live is not None:
            self._live.update(self._picture(view, speedup), refresh=True)
        else:
            self._console.print(self._line(view, speedup), highlight=False, soft_wrap=True)

    def _line(self, view: View, speedup: float | None) -> str:
        rate = f"  {speedup:.0f}x real time" if speedup else ""
        return (
            f"t {view.time_s:6.1f} s  x {view.position_m:9.2f} m  v {view.speed_mps * 3.6:6.2f} km/h"
            f"  reference {view.reference_speed_mps * 3.6:6.2f} km/h  {view.mode}{rate}"
        )

    def _picture(self, view: View, speedup: float | None) -> RenderableType:
        journey = self._scenario.journey
        start, end = journey.origin.position_m, journey.destination.position_m
        done = min(max(view.position_m - start, 0.0), end - start)
        strip = Table.grid(padding=(0, 1), expand=True)
        strip.add_column(no_wrap=True)
        strip.add_column(ratio=1)
        strip.add_column(no_wrap=True)
        strip.add_row(
            f"[bold]{journey.origin.name}[/bold]",
            ProgressBar(total=end - start, completed=done),
            f"[bold]{journey.destination.name}[/bold]",
        )
        mode_colour = {"RUN": "green", "STOPPING": "cyan", "DEGRADED": "yellow", "EMERGENCY": "red"}
        facts = Text.assemble(
            (f" {view.speed_mps * 3.6:6.2f}", "bold"),
            f" km/h   reference {view.reference_speed_mps * 3.6:6.2f} km/h   {view.position_m:8.1f} m"
            f"   to the stop {view.distance_to_stop_m:8.1f} m   t {view.time_s:6.1f} s   ",
            (view.mode, mode_colour.get(view.mode, "dim")),
            "" if view.supervision in ("NORMAL", "-") else f"  {view.supervision}",
            f"   {speedup:.0f}x real time" if speedup else "",
        )
        return Group(strip, facts)
