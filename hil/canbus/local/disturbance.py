"""Disturbed frames, on purpose: which transmissions meet a bit error, and at which bit. Seeded."""

from __future__ import annotations

import random
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from hil.canbus.local.wire import EXTENDED, EXTENDED_MASK

Choose = Callable[[Hashable, int, bytes], bool]
"""Called with sender, identifier (with SocketCAN's flag bits) and data of each transmission."""


@dataclass(slots=True)
class Disturbance:
    """One reason why transmissions fail; `failed` counts them. Attempts to repeat a frame count as well."""

    probability: float = 1.0
    can_id: int | None = None
    """With SocketCAN's flag bits; None: any."""
    mask: int = EXTENDED | EXTENDED_MASK
    """Bits of the identifier that have to agree with `can_id`."""
    sender: Hashable = None
    """None: any."""
    choose: Choose | None = None
    bit: int | None = None
    """Which bit of the frame is hit, 0 is the start of frame; None: any, at random."""
    count: int | None = None
    """How many transmissions are hit at most."""
    failed: int = 0

    def __post_init__(self) -> None:
        # A program may have sent them: found out here, and not when they meet a frame.
        for name in ("can_id", "mask", "bit", "count", "failed"):
            value = getattr(self, name)
            if not isinstance(value, int) and (value is not None or name in ("mask", "failed")):
                raise TypeError(f"{name} {value!r} is no whole number")
        if self.choose is not None and not callable(self.choose):
            raise TypeError(f"choose {self.choose!r} cannot be called")
        if not 0.0 <= self.probability <= 1.0:
            raise ValueError(f"probability {self.probability:g} is not in 0..1")
        if self.bit is not None and self.bit < 0:
            raise ValueError(f"bit {self.bit} of a frame: must not be negative")


class Disturbances:
    """All of them; the same seed and the same transmissions give the same errors."""

    def __init__(self, seed: int) -> None:
        self._entries: list[Disturbance] = []
        self._random = random.Random(seed)

    def add(self, disturbance: Disturbance) -> None:
        """Add a reason; the first one that hits a transmission counts."""
        self._entries.append(disturbance)

    def clear(self) -> None:
        """From here on no frame is disturbed."""
        self._entries.clear()

    @property
    def active(self) -> bool:
        """Whether a transmission can be hit."""
        return any(entry.count is None or entry.failed < entry.count for entry in self._entries)

    def hit(self, sender: Hashable, can_id: int, data: bytes, bits: int) -> int | None:
        """The bit that is hit of a transmission of `bits` bits, or None."""
        for entry in self._entries:
            if entry.count is not None and entry.failed >= entry.count:
                continue
            if entry.can_id is not None and (can_id ^ entry.can_id) & entry.mask:
                continue
            if entry.sender is not None and entry.sender != sender:
                continue
            if entry.choose is not None and not entry.choose(sender, can_id, data):
                continue
            if entry.probability < 1.0 and self._random.random() >= entry.probability:
                continue
            entry.failed += 1
            return self._random.randrange(bits) if entry.bit is None else min(entry.bit, bits - 1)
        return None
