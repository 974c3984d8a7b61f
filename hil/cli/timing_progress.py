"""The progress of `hil timing`: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

PLAIN_EVERY_S = 10.0


class TimingProgress:
    """Shows how much of `seconds` is done; a context manager."""

    def __init__(self, console: Console, seconds: float) -> None:
        self._console = console
        self._seconds = seconds
        self._last = 0.0
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(),
            console=console, transient=True, disable=not console.is_terminal, refresh_per_second=2,
        )  # fmt: skip
        self._task = self._bar.add_task("starting", total=seconds)

    def show(self, done_s: float, what: str) -> None:
        """So many seconds are done; `what` is measured now."""
        now = time.monotonic()
        if self._console.is_terminal:
            if now - self._last > 0.25:
                self._last = now
                self._bar.update(self._task, completed=min(done_s, self._seconds), description=f"{what:42s}")
        elif now - self._last > PLAIN_EVERY_S:
            self._last = now
            self._console.print(f"{done_s:5.0f} of {self._seconds:.0f} s: {what}", highlight=False)

    def __enter__(self) -> TimingProgress:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
