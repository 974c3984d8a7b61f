"""The wire of one CAN bus as a model: arbitration, wire time, errors. Integer ns, no clock, no sockets.

Each node offers the first frame of its queue; when the bus is free, the lowest identifier wins, and nothing
interrupts it. Not modelled: clock tolerance, propagation, overload frames. Two nodes that send the same
identifier at the same instant would meet a bit error on a real bus unless their frames are equal; here the
one that waited longer goes first, and it is counted (`collisions`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import Any, Literal

from hil.canbus.local.arbitration import Arbitration
from hil.canbus.local.bits import INTERFRAME_BITS, FrameBits, duration_ns
from hil.canbus.local.confinement import Confinement, State
from hil.canbus.local.disturbance import Disturbance, Disturbances
from hil.canbus.local.medium_node import Failure, Node, Transmission, Waiting
from hil.canbus.local.membership import Membership
from hil.canbus.local.recovery import RESTART_NS, Recovery
from hil.canbus.local.traffic import Traffic
from hil.canbus.local.wire_frame import (
    Completed,
    Dropped,
    Event,
    Reported,
    WireFrame,
    arbitration_field,
    bits_of,
)

__all__ = ["Completed", "Dropped", "Event", "Medium", "Reported", "WireFrame", "arbitration_field", "bits_of"]

ERROR_FLAG_BITS = 6
"""Sent by who sees the error first; the others see it by this flag and add theirs: 12 bits in all."""

ERROR_DELIMITER_BITS = 8
SUSPEND_BITS = 8
"""An error-passive node waits so much longer than the others after a transmission of its own."""

_BITS_FROM_ACK_DELIMITER = 1 + 7  # to the end of the frame


class Medium:
    """The bus. Nodes are any hashable; they join by themselves with their first frame.

    `queue`: "fifo" as most SocketCAN drivers, or "priority" as full-CAN controllers: what a node offers
    first. `listeners`: nodes beyond those that joined that acknowledge every frame. `restart_ns`: how long a
    node stays bus-off before it waits for 128 x 11 recessive bits (as restart-ms of SocketCAN); None: until
    `restart`. Times handed over must not decrease. Raises ValueError for bit rates not above 0.
    """

    def __init__(
        self,
        bitrate: int,
        data_bitrate: int | None = None,
        *,
        queue: Literal["fifo", "priority"] = "fifo",
        listeners: int = 1,
        restart_ns: int | None = RESTART_NS,
        seed: int = 0,
    ) -> None:
        for rate in (bitrate, data_bitrate):
            if rate is not None and rate <= 0:
                raise ValueError(f"bit rate {rate} must be above 0 bit/s")
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.traffic = Traffic()
        self._by_priority = queue == "priority"
        self._disturbances = Disturbances(seed)
        self._nodes = Membership(listeners)
        self._arbitration = Arbitration()  # those with frames that wait
        self._off = Recovery(bitrate, restart_ns)  # those that are bus-off
        self._queued = 0
        self._free_ns = 0
        self._now_ns = 0
        self._sending: Transmission | None = None
        self._last: Transmission | None = None
        self._events: deque[Event] = deque()

    # -- nodes ---------------------------------------------------------------------------------------------

    def join(self, node: Hashable, now_ns: int = 0) -> None:
        """A node that takes part from now on: acknowledges, and may send."""
        self._run(now_ns - 1)
        self._nodes.join(node)

    def leave(self, node: Hashable, now_ns: int = 0) -> None:
        """A node acknowledges no more; what it has queued is still sent if somebody is left to hear it."""
        self._run(now_ns - 1)
        entry = self._nodes.get(node)
        if entry is not None and not entry.leaving:
            self._nodes.leave(entry)
            self._forget_idle()

    def restart(self, node: Hashable, now_ns: int) -> None:
        """Let a node that is bus-off wait for 128 x 11 recessive bits now, then take part again."""
        self._run(now_ns - 1)
        self._nodes[node].restart_at_ns = now_ns

    def pending(self, node: Hashable) -> int:
        """Frames that wait in the queue of a node, the one on the wire included."""
        entry = self._nodes.get(node)
        if entry is None:
            return 0
        return len(entry.waiting) + (self._sending is not None and self._sending.node is entry)

    @property
    def collisions(self) -> int:
        """How often two nodes offered the same identifier at one instant."""
        return self._arbitration.collisions

    def confinement(self, node: Hashable) -> Confinement:
        """Error counters and state of a node; KeyError: it has not joined."""
        return self._nodes[node].confinement

    # -- frames --------------------------------------------------------------------------------------------

    def submit(self, sender: Hashable, frame: WireFrame, now_ns: int) -> bool:
        """Queue a frame at `now_ns`; False: not taken, because the node is bus-off. ValueError: no frame.

        It takes part in the arbitration of its own instant, if `advance` was not called for that yet.
        """
        self._run(now_ns - 1)
        self._now_ns = max(self._now_ns, now_ns - 1)
        node = self._nodes.join(sender)
        if node.confinement.state is State.BUS_OFF:
            node.dropped += 1
            return False
        arbitration = arbitration_field(frame.can_id)
        self._queued += 1
        key = (arbitration if self._by_priority else 0, self._queued)
        self._arbitration.offer(sender, node, Waiting(key, arbitration, now_ns, frame, bits_of(frame)))
        return True

    def corrupt(self, **disturbance: Any) -> Disturbance:
        """From now on let transmissions meet a bit error; keywords: those of `Disturbance`."""
        entry = Disturbance(**disturbance)
        self._disturbances.add(entry)
        return entry

    def corrupt_no_more(self) -> None:
        """From now on no transmission is disturbed."""
        self._disturbances.clear()

    def next_event_ns(self) -> int | None:
        """When something happens next if nobody queues a frame; None: nothing does.

        A frame that nobody can acknowledge any more is repeated without an event.
        """
        if self._events:
            return self._now_ns
        recovery = self._next_recovery()
        if self._last is not None and self._is_unheard(self._last):
            return None
        sending = self._sending
        next_ns = self._next_start() if sending is None else sending.end_ns
        if recovery is None or next_ns is None:
            return next_ns if recovery is None else recovery[0]
        return min(next_ns, recovery[0])

    def advance(self, now_ns: int) -> list[Completed]:
        """Let time pass to `now_ns`, included; the frames whose last bit was sent by then, in that order."""
        return [event for event in self.events(now_ns) if isinstance(event, Completed)]

    def events(self, now_ns: int) -> list[Event]:
        """Like `advance`, with dropped frames and what the controllers report, in the order of time."""
        self._run(now_ns)
        self._now_ns = max(self._now_ns, now_ns)
        happened = list(self._events)
        self._events.clear()
        return happened

    def load(self, window_ns: int | None = None) -> float:
        """Share of the time in which the bus was busy (interframe space counts), 0..1.

        Over the last `window_ns` (at most a minute, in steps of 0.1 s), or since the first frame was queued.
        """
        return self.traffic.load(self._now_ns, window_ns)

    def statistics(self) -> dict[str, Any]:
        """Counters of traffic and nodes, SI units, JSON types."""
        return {
            "bitrate": self.bitrate,
            "data_bitrate": self.data_bitrate,
            "collisions": self.collisions,
            **self.traffic.statistics(self._now_ns),
            "nodes": [node.statistics(name, self.pending(name)) for name, node in self._nodes.nodes()],
        }

    # -- time ----------------------------------------------------------------------------------------------

    def _run(self, until_ns: int) -> None:
        while True:
            recovery = self._next_recovery()
            sending = self._sending
            if sending is not None:
                next_ns: int | None = sending.end_ns
            else:
                next_ns = self._next_start()
            if recovery is not None and (next_ns is None or recovery[0] <= next_ns):
                if recovery[0] > until_ns:
                    return
                self._recover(*recovery)
            elif next_ns is None or next_ns > until_ns:
                return
            elif sending is None:
                self._start(next_ns)
            else:
                self._finish(sending)
                if self._is_unheard(sending):
                    self._skip_unheard(sending, until_ns)

    def _next_start(self) -> int | None:
        """When the next transmission starts."""
        ready_ns = self._arbitration.next_ready_ns()
        return None if ready_ns is None else max(self._free_ns, ready_ns)

    def _start(self, start_ns: int) -> None:
        """Arbitration, and how its winner will fare."""
        winner, node, entry = self._arbitration.take_winner(start_ns)
        self._off.count_idle(self._free_ns, start_ns)
        bits, frame = entry.bits, entry.frame
        heard = self._nodes.hears(winner)
        failure: Failure = "" if heard else "ack"
        hit = self._disturbances.hit(winner, frame.can_id, bytes(frame.data), bits.total)
        if hit is not None:
            failure = "bit"
        elif not heard:
            hit = bits.total - _BITS_FROM_ACK_DELIMITER - 1  # the ACK slot
        if hit is None:
            end_ns = start_ns + self._time(bits.nominal_bits, bits.data_bits)
        else:
            end_ns = start_ns + self._time_until_error_ends(bits, hit, heard=heard)
        free_ns = end_ns + self._time(INTERFRAME_BITS, 0)
        self._sending = Transmission(winner, node, entry, start_ns, end_ns, free_ns, failure)

    def _finish(self, sending: Transmission) -> None:
        """The end of a frame, or of an error frame."""
        node, end_ns = sending.node, sending.end_ns
        self._sending, self._last = None, sending
        self._free_ns = sending.free_ns
        if sending.failure:
            self._failed(sending)
        else:
            self._succeeded(sending)
        self._off.count_frame(sending.start_ns)
        if node.confinement.state is State.PASSIVE:
            node.suspended_until_ns = self._free_ns + self._time(SUSPEND_BITS, 0)
        elif node.confinement.state is State.BUS_OFF:
            self._switch_off(sending.sender, node, end_ns)
        if node.leaving:
            self._forget_idle()

    def _succeeded(self, sending: Transmission) -> None:
        """The frame was sent and acknowledged."""
        node, entry, end_ns = sending.node, sending.entry, sending.end_ns
        node.sent += 1
        self._events.append(Completed(end_ns, sending.sender, entry.frame))
        self.traffic.sent(
            entry.frame.can_id,
            entry.bits.total + INTERFRAME_BITS,
            entry.queued_ns,
            sending.start_ns,
            sending.free_ns,
        )
        self._events += self._nodes.transmitted(sending)

    def _failed(self, sending: Transmission) -> None:
        """An error frame was sent: the frame is still to be sent."""
        self._arbitration.offer(sending.sender, sending.node, sending.entry)
        sending.node.retransmissions += 1
        self.traffic.failed(sending.entry.queued_ns, sending.start_ns, sending.free_ns)
        self._events += self._nodes.failed(sending)

    def _skip_unheard(self, failed: Transmission, until_ns: int) -> None:
        """Jump over repetitions that change nothing: a passive node that is alone with its frame."""
        node = failed.node
        start_ns = max(self._free_ns, node.suspended_until_ns)
        busy_ns = failed.free_ns - failed.start_ns
        suspend_ns = self._time(SUSPEND_BITS, 0)
        period_ns = busy_ns + suspend_ns
        repetitions = (until_ns - start_ns) // period_ns
        if repetitions <= 0:
            return
        node.retransmissions += repetitions
        self.traffic.failed_again(start_ns, busy_ns, period_ns, repetitions)
        node.suspended_until_ns = start_ns + repetitions * period_ns
        self._free_ns = node.suspended_until_ns - suspend_ns

    # -- bus-off -------------------------------------------------------------------------------------------

    def _switch_off(self, name: Hashable, node: Node, now_ns: int) -> None:
        for entry in sorted(node.waiting):
            self._events.append(Dropped(now_ns, name, entry.frame))
        node.dropped += len(node.waiting)
        node.waiting.clear()
        self._arbitration.withdraw(name)
        self._off.add(name, node, now_ns)
        self._nodes.switched_off(node)

    def _next_recovery(self) -> tuple[int, Hashable] | None:
        """When a node that was bus-off takes part again if the bus stays idle, and which."""
        return None if self._sending is not None or not self._off else self._off.next(self._free_ns)

    def _recover(self, time_ns: int, name: Hashable) -> None:
        self._off.remove(name)
        self._events += self._nodes.recovered(name, time_ns)

    # -- small things --------------------------------------------------------------------------------------

    def _time(self, nominal_bits: int, data_bits: int) -> int:
        return duration_ns(nominal_bits, data_bits, self.bitrate, self.data_bitrate)

    def _time_until_error_ends(self, bits: FrameBits, hit: int, *, heard: bool) -> int:
        """From the start of a frame that meets an error at bit `hit` to the end of its error frame."""
        at_rate = min(max(0, hit + 1 - bits.head_bits), bits.data_bits)
        flag = ERROR_FLAG_BITS * (2 if heard else 1)
        return self._time(hit + 1 - at_rate + flag + ERROR_DELIMITER_BITS, at_rate)

    def _is_unheard(self, failed: Transmission) -> bool:
        """Whether this goes on and on: nobody acknowledges, and the error counter stays where it is."""
        node = failed.node
        first = node.waiting[0] if self._sending is None and node.waiting else failed.entry
        return (
            failed.failure == "ack"
            and node.confinement.state is State.PASSIVE
            and first is failed.entry
            and not self._off
            and not self._disturbances.active
            and all(other is node for _, other in self._arbitration.nodes())
            and not self._nodes.hears(failed.sender)
        )

    def _forget_idle(self) -> None:
        """Forget the nodes that left and have nothing to send, or nobody to send it to."""
        for name in self._nodes.take_idle(None if self._sending is None else self._sending.node):
            self._arbitration.withdraw(name)
            self._off.remove(name)
