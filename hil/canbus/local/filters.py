"""Local bus, what a client wants to receive: python-can's filters, meant as in SocketCAN, applied in the hub.

A frame passes when it matches one filter: `received_id & mask == id & mask`, and the kind of identifier if
the filter names one. An identifier with bit 29 set (CAN_INV_FILTER) inverts its filter. Error frames
always pass, as they do on a SocketCAN bus of python-can.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hil.canbus.local.wire import ERROR, EXTENDED, EXTENDED_MASK, FD, FLAGS_OFFSET, HEADER, HEADER_SIZE, OWN

Filter = tuple[int, int, bool | None]
"""Identifier, mask, extended (None: both kinds)."""

INVERT = 0x2000_0000
NOTHING: Filter = (INVERT, 0, None)
"""Matches no frame: the inversion of a filter that matches all."""

_MEMORY_LIMIT = 65_536  # identifiers whose verdict is remembered; more come from random 29-bit traffic only


def pack_filters(filters: Iterable[Mapping[str, Any]] | None) -> list[Filter] | None:
    """python-can's filters in the form that travels to the hub; None receives everything."""
    if filters is None:
        return None
    return [
        (
            int(entry["can_id"]),
            int(entry["can_mask"]),
            bool(entry["extended"]) if "extended" in entry else None,
        )
        for entry in filters
    ]


class Acceptance:
    """The hub's acceptance filter of one client."""

    def __init__(self, filters: Sequence[Filter]) -> None:
        self._filters = [(int(can_id), int(mask), extended) for can_id, mask, extended in filters]
        self._verdicts: dict[int, bool] = {}

    def accepts(self, can_id: int) -> bool:
        """Whether a frame passes; `can_id` with SocketCAN's flag bits."""
        verdict = self._verdicts.get(can_id)
        if verdict is None:
            if len(self._verdicts) >= _MEMORY_LIMIT:
                self._verdicts.clear()
            verdict = self._verdicts[can_id] = self._decide(can_id)
        return verdict

    def _decide(self, can_id: int) -> bool:
        if can_id & ERROR:
            return True
        identifier = can_id & EXTENDED_MASK
        is_extended = bool(can_id & EXTENDED)
        for filter_id, mask, extended in self._filters:
            if extended is not None and extended != is_extended:
                continue
            matches = (identifier ^ filter_id) & mask & EXTENDED_MASK == 0
            if matches != bool(filter_id & INVERT):
                return True
        return False


def select_records(
    records: bytes | bytearray, acceptance: Acceptance | None, *, fd: bool
) -> bytes | bytearray:
    """The whole records in `records` that a client gets; without `fd` CAN FD frames are left out."""
    chosen = []
    offset, size = 0, len(records)
    unpack_from = HEADER.unpack_from
    while offset < size:
        _, can_id, length, flags, _ = unpack_from(records, offset)
        end = offset + HEADER_SIZE + length
        if (fd or not flags & FD) and (acceptance is None or acceptance.accepts(can_id)):
            if end - offset == size:
                return records  # the only one, as it is
            chosen.append(records[offset:end])
        offset = end
    return b"".join(chosen)


def marked_own(records: bytes | bytearray) -> bytearray:
    """A copy of `records` for the client that sent them: its own frames."""
    marked = bytearray(records)
    offset, size = 0, len(marked)
    while offset < size:
        marked[offset + FLAGS_OFFSET] |= OWN
        offset += HEADER_SIZE + HEADER.unpack_from(marked, offset)[2]
    return marked
