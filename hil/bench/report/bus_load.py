"""What every message put on the bus in a run, from the frames counted and their shortest and longest form.

How many stuff bits a frame had is in the frame log, not here: the load lies between two bounds (frame without
stuff bits; worst case of Davis et al., Real-Time Systems 35 (2007), equation 1). `hil bus load RUN` reads the
log.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.bench.report.source import RunSource
from hil.canbus.analysis.message_set import BusMessage, MessageSetError, message_set
from hil.canbus.contract import ContractError

__all__ = ["DEFAULT_BITRATE", "BusLoad", "MessageRow", "bus_load"]

DEFAULT_BITRATE = 500_000
"""bit/s, assumed when the bus of the run had none."""


@dataclass(frozen=True)
class MessageRow:
    """One message: frames, frames/s, share of the bus without and with all stuff bits (0 to 1)."""

    name: str
    can_id: int
    sender: str
    frames: int
    rate: float
    low: float
    high: float
    e2e: Mapping[str, int] | None


@dataclass(frozen=True)
class BusLoad:
    """The bus of a run. `load` is what was measured on the wire, None if nobody did; `note` what to know."""

    rows: tuple[MessageRow, ...]
    bitrate: int
    load: float | None
    low: float
    high: float
    note: str
    left_out: tuple[str, ...]


def bus_load(source: RunSource) -> BusLoad | None:
    """Load per message, largest first; None if the recorder did not come to count."""
    run = source.recording
    counts: Mapping[str, int] = run.recording.get("frames_by_message", {}) if run is not None else {}
    duration_s = float(run.recording.get("duration_s") or 0.0) if run is not None else 0.0
    if run is None or not counts or duration_s <= 0:
        return None
    bus: Mapping[str, Any] = source.summary.get("bus", {})
    bitrate = int(bus.get("bitrate") or DEFAULT_BITRATE)
    protection = bus.get("e2e", {})
    messages = _messages(run.dbc)
    rows: list[MessageRow] = []
    left_out: list[str] = []
    for name, frames in counts.items():
        if name not in messages:
            left_out.append(name)
            continue
        message, rate = messages[name], frames / duration_s
        low, high = (bits.duration_ns(bitrate) * 1e-9 * rate for bits in (message.best, message.worst))
        counted = protection.get(name)
        rows.append(MessageRow(name, message.can_id, message.sender, frames, rate, low, high, counted))
    rows.sort(key=lambda row: -row.high)
    note = (
        f"The bus had no bit rate; shares are those of a bus with {bitrate // 1000} kbit/s."
        if not bus.get("bitrate")
        else f"Shares of {bitrate // 1000} kbit/s."
    )
    low, high = sum(row.low for row in rows), sum(row.high for row in rows)
    return BusLoad(tuple(rows), bitrate, bus.get("load"), low, high, note, tuple(left_out))


def _messages(dbc: str) -> dict[str, BusMessage]:
    """The messages of the recorded DBC that take part in arbitration; none if it cannot be analysed."""
    try:
        with tempfile.TemporaryDirectory(prefix="hil-") as scratch:
            path = Path(scratch) / "recorded.dbc"
            path.write_text(dbc, encoding="utf-8")
            return {message.name: message for message in message_set(path).messages}
    except (ContractError, MessageSetError):
        return {}
