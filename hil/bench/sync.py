"""The bench's own node on the bus: heartbeat, and the SYNC that drives lockstep."""

from __future__ import annotations

import time

from hil.bench.errors import BenchError
from hil.bench.watch import Watch
from hil.canbus.contract import Contract
from hil.node.inbox import bus_identifier
from hil.node.unit import FrameLink

LAST_IN_CHAIN = "TCU_SyncDone"
"""Who acknowledges a tick last: the plant, which waits for the controller."""

CONTROLLERS_ANSWER = "ATO_SyncDone"

HEARTBEAT_OPERATIONAL = {"NmtState": 5}


class BenchNode:
    """Sends what the node BENCH of the DBC sends, and hears what the watch wants to know."""

    def __init__(self, transport: FrameLink, contract: Contract, watch: Watch, *, tick_s: float) -> None:
        self._transport = transport
        self._watch = watch
        self._sync = contract.message("SYNC")
        self._done = contract.message(LAST_IN_CHAIN)
        self._answer = contract.message(CONTROLLERS_ANSWER)
        self.controller_is_gone = False  # then the bench answers in its place, and the plant goes on
        heartbeat = contract.message("BENCH_Heartbeat")
        self._heartbeat = bus_identifier(heartbeat), bytes(heartbeat.encode(HEARTBEAT_OPERATIONAL))
        self._heartbeat_s = (heartbeat.cycle_ns or 100_000_000) * 1e-9
        self._ticks_per_heartbeat = max(1, round(self._heartbeat_s / tick_s))
        self._next_heartbeat_s = 0.0

    def listen(self) -> None:
        """Take what waits on the bus; in real time also send the heartbeat when it is due."""
        for frame in self._transport.drain():
            self._watch.hear(frame.can_id, frame.data)
        now = time.monotonic()
        if now >= self._next_heartbeat_s:
            self._next_heartbeat_s = now + self._heartbeat_s
            self._transport.send(*self._heartbeat)

    def begin_tick(self, tick: int) -> None:
        """Send SYNC for this tick, the heartbeat before it when it is due."""
        sync = bus_identifier(self._sync), self._sync.encode({"Tick": tick})
        heartbeat_is_due = tick % self._ticks_per_heartbeat == 0
        self._transport.send_all([self._heartbeat, sync] if heartbeat_is_due else [sync])
        if self.controller_is_gone:
            self.answer_for_controller(tick)

    def answer_for_controller(self, tick: int) -> None:
        """Let the plant go on although no controller answers: its command supervision brakes the train."""
        self.controller_is_gone = True
        self._transport.send(bus_identifier(self._answer), self._answer.encode({"Tick": tick}))

    def await_tick(self, tick: int, *, timeout_s: float) -> bool:
        """Hear frames until the last node has done `tick`; False if nothing came for `timeout_s`.

        Raises BenchError if a node acknowledges another tick: two benches on one bus.
        """
        done, receive, hear = bus_identifier(self._done), self._transport.receive, self._watch.hear
        while (frame := receive(timeout_s)) is not None:
            if frame.can_id != done:
                hear(frame.can_id, frame.data)
                continue
            answered = int(self._done.decode(frame.data)["Tick"])
            if answered == tick:
                return True
            if answered > tick:
                raise BenchError(
                    f"lockstep: {LAST_IN_CHAIN} answers tick {answered}, but tick {tick} is running:"
                    " another bench drives the same channel; use another -c"
                )
        return False
