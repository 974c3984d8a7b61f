"""Pictures made of characters: the line with its limits and the train, a speed gauge, a course."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

from rich.text import Text

from hil.railway import Journey

__all__ = ["Strip", "gauge", "sparkline"]

BLOCKS = "▁▂▃▄▅▆▇█"
TRAIN, STATION, DONE, AHEAD, MARK, LIMIT = "▶", "┿", "━", "─", "│", "▏"
LEAST_RANGE = 0.1
"""A sparkline of smaller values stays flat: noise is no news."""


class Strip:
    """A journey as `width` characters, its start at the left whichever way it goes."""

    def __init__(self, journey: Journey, width: int) -> None:
        self._width = max(width, 2)
        self._start_m = journey.origin.position_m
        self._length_m = journey.destination.position_m - self._start_m
        self._line = journey.line
        self._stops = {self.column(stop.position_m) for stop in journey.line.stops}

    def column(self, position_m: float) -> int:
        """The character in which a position lies; may be outside of the strip."""
        if not self._length_m:
            return 0
        return round((position_m - self._start_m) / self._length_m * (self._width - 1))

    def track(self, position_m: float) -> Text:
        """The line with its stations; the train where it is."""
        here = min(max(self.column(position_m), 0), self._width - 1)
        text = Text(no_wrap=True)
        for column in range(self._width):
            if column == here:
                text.append(TRAIN, "bold")
            elif column in self._stops:
                text.append(STATION, "bold")
            else:
                text.append(DONE if column < here else AHEAD, "green" if column < here else "dim")
        return text

    def limits(self, position_m: float) -> Text:
        """The speed limits of the line as heights; the one that holds at the train is bright."""
        here = min(max(self.column(position_m), 0), self._width - 1)
        top = max(self._limits)
        text = Text(no_wrap=True)
        for column, limit_mps in enumerate(self._limits):
            height = BLOCKS[min(int(limit_mps / top * len(BLOCKS)), len(BLOCKS) - 1)]
            text.append(height, "bold yellow" if column == here else "dim yellow")
        return text

    @cached_property
    def _limits(self) -> list[float]:
        """The lowest limit of the line within each character."""
        found = []
        step = self._length_m / max(self._width - 1, 1)
        for column in range(self._width):
            middle = self._start_m + column * step
            low, high = sorted((middle - step / 2, middle + step / 2))
            over = [s.limit_mps for s in self._line.speed_limits if s.start_m < high and s.end_m > low]
            found.append(min(over, default=self._line.default_limit_mps))
        return found


def gauge(
    speed_mps: float, reference_mps: float, limit_mps: float | None, *, full: float, width: int
) -> Text:
    """A bar for the speed; `│` the reference, `▏` the limit. `full` is the speed at its right end."""
    scale = (width - 1) / max(full, 1e-9)
    speed, reference = round(speed_mps * scale), round(reference_mps * scale)
    limit = None if limit_mps is None else min(round(limit_mps * scale), width - 1)
    over = limit_mps is not None and speed_mps > limit_mps
    text = Text(no_wrap=True)
    for column in range(width):
        if column == reference:
            text.append(MARK, "bold cyan")
        elif column < speed:
            text.append("█", "red" if over else "green")
        elif column == limit:
            text.append(LIMIT, "yellow")
        else:
            text.append("·", "dim")
    return text


def sparkline(values: Iterable[float]) -> str:
    """Values as heights, zero in the middle."""
    numbers = list(values)
    reach = max([abs(number) for number in numbers] + [LEAST_RANGE])
    heights = BLOCKS[:-1]  # an odd number, so that zero has one of its own
    steps = len(heights) - 1
    return "".join(heights[round((number / reach + 1.0) / 2.0 * steps)] for number in numbers)
