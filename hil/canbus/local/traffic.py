"""What was on the wire: bus load, and frames, bits and waiting times of each identifier."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

SLOT_NS = 100_000_000
_SLOTS = 600  # a minute
_MESSAGES_TOLD = 300  # in the statistics, which have to fit a control record


@dataclass(slots=True)
class MessageTraffic:
    """One identifier; bits and time with interframe space, without failed attempts."""

    frames: int = 0
    bits: int = 0
    busy_ns: int = 0
    longest_response_ns: int = 0
    """From queued to the end of the interframe space."""


class Traffic:
    """Counts what `Medium` sends."""

    def __init__(self) -> None:
        self.messages: dict[int, MessageTraffic] = {}
        """By identifier with SocketCAN's flag bits."""
        self.frames = 0
        self.failed_frames = 0
        self.busy_ns = 0
        self.first_ns: int | None = None
        self._slots: deque[tuple[int, int]] = deque(maxlen=_SLOTS)  # slot number, busy time in it

    def sent(self, can_id: int, bits: int, queued_ns: int, start_ns: int, free_ns: int) -> None:
        """A frame was sent; it was queued, started, and the bus was free again then."""
        message = self.messages.get(can_id)
        if message is None:
            message = self.messages[can_id] = MessageTraffic()
        message.frames += 1
        message.bits += bits
        message.busy_ns += free_ns - start_ns
        message.longest_response_ns = max(message.longest_response_ns, free_ns - queued_ns)
        self.frames += 1
        self._busy(queued_ns, start_ns, free_ns - start_ns)

    def failed(self, queued_ns: int, start_ns: int, free_ns: int) -> None:
        """An attempt met an error."""
        self.failed_frames += 1
        self._busy(queued_ns, start_ns, free_ns - start_ns)

    def failed_again(self, start_ns: int, busy_ns: int, period_ns: int, repetitions: int) -> None:
        """So many attempts met an error, one every `period_ns` from `start_ns` on, each `busy_ns` long."""
        self.failed_frames += repetitions
        total_ns = busy_ns * repetitions
        last = (start_ns + (repetitions - 1) * period_ns) // SLOT_NS
        first = max(start_ns // SLOT_NS, last - _SLOTS + 1)
        share_ns = min(total_ns // (last - first + 1), SLOT_NS * busy_ns // period_ns)
        for slot in range(first, last):
            self._busy(start_ns, slot * SLOT_NS, share_ns)
            total_ns -= share_ns
        self.busy_ns += max(0, total_ns - share_ns)
        self._busy(start_ns, last * SLOT_NS, min(share_ns, total_ns))

    def load(self, now_ns: int, window_ns: int | None) -> float:
        """Share of the time in which the bus was busy: the last `window_ns`, or since the first frame."""
        if self.first_ns is None:
            return 0.0
        since_ns = self.first_ns
        if window_ns is not None:
            since_ns = max(since_ns, (now_ns - window_ns) // SLOT_NS * SLOT_NS)
        elapsed_ns = now_ns - since_ns
        if elapsed_ns <= 0:
            return 0.0
        if window_ns is None:
            busy_ns = self.busy_ns
        else:
            busy_ns = sum(busy for slot, busy in self._slots if (slot + 1) * SLOT_NS > since_ns)
        return min(1.0, busy_ns / elapsed_ns)

    def statistics(self, now_ns: int) -> dict[str, Any]:
        """Counters, JSON types; identifiers as "0x181" (standard) or "0x00000181" (extended)."""
        elapsed_ns = 0 if self.first_ns is None else max(0, now_ns - self.first_ns)
        chosen = sorted(self.messages.items(), key=lambda item: -item[1].busy_ns)[:_MESSAGES_TOLD]
        return {
            "load": round(self.load(now_ns, None), 6),
            "load_last_second": round(self.load(now_ns, 1_000_000_000), 6),
            "busy_ns": self.busy_ns,
            "time_ns": now_ns,
            "frames_on_wire": self.frames,
            "failed_frames": self.failed_frames,
            "messages": {
                _name(can_id): {
                    "frames": message.frames,
                    "bits": message.bits,
                    "load": round(message.busy_ns / elapsed_ns, 6) if elapsed_ns else 0.0,
                    "longest_response_us": round(message.longest_response_ns / 1000, 3),
                }
                for can_id, message in chosen
            },
        }

    def _busy(self, queued_ns: int, start_ns: int, busy_ns: int) -> None:
        if self.first_ns is None:
            self.first_ns = queued_ns
        self.busy_ns += busy_ns
        slot = start_ns // SLOT_NS
        if self._slots and self._slots[-1][0] == slot:
            self._slots[-1] = (slot, self._slots[-1][1] + busy_ns)
        else:
            self._slots.append((slot, busy_ns))


def _name(can_id: int) -> str:
    identifier = can_id & 0x1FFF_FFFF
    text = f"0x{identifier:08x}" if can_id & 0x8000_0000 else f"0x{identifier:03x}"
    return f"{text} remote" if can_id & 0x4000_0000 else text
