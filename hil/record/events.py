"""Events out of frames, by the contract alone: changed states, event messages, silence.

Every signal with a value table of two or more names is a state; its changes are events and lanes. Every
frame of an event message is an event. A message silent for longer than its limit is an event, and so is its
return. Nothing here knows a train.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.canbus.contract import Contract, MessageCodec, SignalSpec
from hil.canbus.frame import EXTENDED_ID_FLAG
from hil.record.blocks import Block, MessageBlock
from hil.record.dashboard import level_of

__all__ = ["Event", "EventDetector", "StateChanges", "is_state", "state_name"]

MOST_TEXTS_PER_BLOCK = 10  # of one signal; a chattering flag shall not bury the rest
NS_PER_MS = 1_000_000


@dataclass(frozen=True)
class Event:
    """Something worth a line: epoch ns, INFO/WARN/ERROR, the node or process it is about, the text."""

    time_ns: int
    level: str
    source: str
    text: str


@dataclass(frozen=True)
class StateChanges:
    """New states of one signal in a block: epoch ns and names."""

    message: str
    signal: SignalSpec
    times_ns: NDArray[np.int64]
    states: tuple[str, ...]


def is_state(signal: SignalSpec) -> bool:
    """Whether a signal is a state: its value table names at least two values."""
    return len(signal.choices) >= 2


def state_name(signal: SignalSpec, value: float) -> str:
    """Name of a value, or the number where the table has none."""
    return signal.choices.get(int(value), str(int(value)))


class EventDetector:
    """Remembers the last state of every signal and the last frame of every message."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._states = {
            codec.name: [(column, signal) for column, signal in enumerate(codec.signals) if is_state(signal)]
            for codec in contract.messages.values()
        }
        self._last: dict[tuple[str, str], float] = {}
        self._heard_ns: dict[str, int] = {}
        self._silent: set[str] = set()
        self._reported: set[str] = set()

    def scan(self, block: Block, times_ns: NDArray[np.int64]) -> tuple[list[Event], list[StateChanges]]:
        """Events and state changes of a block, `times_ns` being the epoch ns of its frames; by time."""
        events: list[Event] = []
        changes: list[StateChanges] = []
        for name, message in block.messages.items():
            times = times_ns[message.rows]
            first = name not in self._heard_ns
            events += self._silence(message.codec, times)
            changed = list(self._changes(message, times))
            changes += changed
            if message.codec.send_type == "event":
                events += [_frame_event(message, row, int(times[row])) for row in range(len(times))]
            else:
                events += self._change_events(message.codec, changed, first)
        events += self._undecoded(block, times_ns)
        if len(times_ns):
            events += self._newly_silent(int(times_ns[-1]))
        return sorted(events, key=lambda event: event.time_ns), changes

    def _changes(self, message: MessageBlock, times: NDArray[np.int64]) -> Iterable[StateChanges]:
        for column, signal in self._states[message.codec.name]:
            values = message.values[:, column]
            key = (message.codec.name, signal.name)
            before = np.concatenate(([self._last.get(key, np.nan)], values[:-1]))
            rows = np.flatnonzero(values != before)  # not-a-number differs from everything: the first counts
            self._last[key] = float(values[-1])
            if len(rows):
                names = tuple(state_name(signal, value) for value in values[rows].tolist())
                yield StateChanges(message.codec.name, signal, times[rows], names)

    def _change_events(
        self, codec: MessageCodec, changed: list[StateChanges], first: bool
    ) -> Iterable[Event]:
        if first and changed:
            at = min(int(change.times_ns[0]) for change in changed)
            states = ", ".join(f"{change.signal.name} {change.states[0]}" for change in changed)
            yield Event(at, "INFO", codec.sender, f"{codec.name}: first heard, {states}")
        for change in changed:
            pairs = list(zip(change.times_ns.tolist(), change.states, strict=True))[1 if first else 0 :]
            for at, state in pairs[:MOST_TEXTS_PER_BLOCK]:
                level = level_of(state, change.signal.name)
                yield Event(at, level, codec.sender, f"{codec.name}: {change.signal.name} {state}")
            if len(pairs) > MOST_TEXTS_PER_BLOCK:
                more = len(pairs) - MOST_TEXTS_PER_BLOCK
                text = f"{codec.name}: {change.signal.name} changed {more} more times"
                yield Event(pairs[-1][0], "WARN", codec.sender, text)

    def _silence(self, codec: MessageCodec, times: NDArray[np.int64]) -> Iterable[Event]:
        """Gaps longer than the limit that this block closed."""
        limit = codec.timeout_ns
        before = self._heard_ns.get(codec.name)
        self._heard_ns[codec.name] = int(times[-1])
        if limit is None:
            return
        heard = times if before is None else np.concatenate(([before], times))
        gaps = np.diff(heard)
        for row in np.flatnonzero(gaps > limit).tolist():
            if codec.name not in self._silent:
                yield _silent_event(codec, int(heard[row]) + limit, limit)
            self._silent.discard(codec.name)
            text = f"{codec.name}: back after {gaps[row] / NS_PER_MS:.0f} ms"
            yield Event(int(heard[row + 1]), "INFO", codec.sender, text)

    def _newly_silent(self, now_ns: int) -> Iterable[Event]:
        for name, heard_ns in self._heard_ns.items():
            codec = self._contract.messages[name]
            if (
                codec.timeout_ns is not None
                and now_ns - heard_ns > codec.timeout_ns
                and name not in self._silent
            ):
                self._silent.add(name)
                yield _silent_event(codec, heard_ns + codec.timeout_ns, codec.timeout_ns)

    def _undecoded(self, block: Block, times_ns: NDArray[np.int64]) -> Iterable[Event]:
        """The contract and the bus disagree: said once per identifier."""
        file = self._contract.path.name
        texts = [
            f"frames with identifier {_identifier(can_id)}, which {file} does not have"
            for can_id in block.unknown
        ]
        texts += [f"{name}: frames of another length than {file} says" for name in block.malformed]
        for text in texts:
            if text not in self._reported:
                self._reported.add(text)
                yield Event(int(times_ns[0]), "WARN", "bus", text)


def _identifier(can_id: int) -> str:
    if can_id >= EXTENDED_ID_FLAG:
        return f"0x{can_id & ~EXTENDED_ID_FLAG:08X} (29 bits)"
    return f"0x{can_id:03X}"


def _silent_event(codec: MessageCodec, time_ns: int, limit_ns: int) -> Event:
    text = f"{codec.name}: silent for more than {limit_ns / NS_PER_MS:g} ms"
    return Event(time_ns, "WARN", codec.sender, text)


def _frame_event(message: MessageBlock, row: int, time_ns: int) -> Event:
    codec = message.codec
    level, parts = "INFO", []
    for column, signal in enumerate(codec.signals):
        if signal.role != "NONE":
            continue
        value = message.values[row, column]
        if is_state(signal):
            state = state_name(signal, value)
            parts.append(f"{signal.name} {state}")
        else:
            parts.append(f"{signal.name} {value:.10g} {signal.unit}".rstrip())
    states = [state_name(s, message.values[row, c]) for c, s in enumerate(codec.signals) if is_state(s)]
    if states and states[0] not in ("CLEARED",):
        level = "ERROR" if codec.name.upper().endswith("EMERGENCY") else level_of(states[0])
    return Event(time_ns, level, codec.sender, f"{codec.name}: {', '.join(parts)}")
