"""Which balise should have been read by now."""

from __future__ import annotations

from collections.abc import Iterable

from hil.railway import Balise


class BaliseWatch:
    """Follows the balises ahead in their order; `missed` stays until the next telegram."""

    def __init__(self, balises: Iterable[Balise], *, start_m: float, tolerance_m: float) -> None:
        ahead = sorted((b for b in balises if b.position_m > start_m), key=lambda b: b.position_m)
        self._positions = [b.position_m for b in ahead]
        self._order = {b.number: k for k, b in enumerate(ahead)}
        self._tolerance_m = tolerance_m
        self._next = 0
        self.missed = False

    def read(self, number: int) -> None:
        """A telegram came in. One of an unknown balise, or of one long passed, changes nothing."""
        place = self._order.get(number)
        if place is not None and place >= self._next - 1:
            self._next = max(self._next, place + 1)
            self.missed = False

    def passed(self, position_m: float) -> None:
        """The train is here."""
        while (
            self._next < len(self._positions) and position_m > self._positions[self._next] + self._tolerance_m
        ):
            self._next += 1
            self.missed = True
