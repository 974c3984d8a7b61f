"""Fakes for the node: a wire without a bus, a clock without time, a unit without a train."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from types import SimpleNamespace

import pytest

from hil.canbus.contract import Contract
from hil.canbus.frame import Frame
from hil.canbus.protection import Protector
from hil.node import Probe


class FakeTime:
    """A monotonic clock that moves when somebody looks at it (100 ns) or sleeps."""

    def __init__(self, now_ns: int = 1_000_000_123, step_ns: int = 100) -> None:
        self.now_ns = now_ns
        self.step_ns = step_ns
        self.sleeps: list[int] = []
        self.oversleep_ns = 0
        self.realtime_offset_ns = 1_700_000_000_000_000_000

    def monotonic(self) -> int:
        self.now_ns += self.step_ns
        return self.now_ns

    def realtime(self) -> int:
        return self.now_ns + self.realtime_offset_ns

    def sleep_until(self, at_ns: int) -> int:
        self.sleeps.append(at_ns)
        self.now_ns = max(self.now_ns, at_ns) + self.oversleep_ns
        return self.monotonic()


class FakeTransport:
    """What was put in `waiting` arrives; what was sent is in `log`. Never blocks."""

    def __init__(self) -> None:
        self.waiting: deque[Frame] = deque()
        self.log: list[tuple[int, bytes]] = []
        self.peers: list[FakeTransport] = []
        self.error: Exception | None = None
        self.received = 0
        self.dropped = 0
        self.waits = 0
        self.on_wait = lambda: None

    @property
    def sent(self) -> int:
        return len(self.log)

    def send_all(self, frames: Sequence[tuple[int, bytes | bytearray]]) -> None:
        for can_id, data in frames:
            self.send(can_id, data)

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        if self.error is not None:
            raise self.error
        self.log.append((can_id, bytes(data)))
        for peer in self.peers:
            peer.waiting.append(Frame(0, can_id, bytes(data)))

    def drain(self) -> list[Frame]:
        frames = list(self.waiting)
        self.waiting.clear()
        self.received += len(frames)
        return frames

    def receive(self, timeout_s: float | None) -> Frame | None:
        if not self.waiting:
            self.waits += 1
            self.on_wait()
        if not self.waiting:
            return None
        self.received += 1
        return self.waiting.popleft()


class FakeUnit:
    """Plays one or more nodes; puts what it is told to and remembers what it saw."""

    name = "fake"

    def __init__(self, **changes) -> None:
        self.nodes = ("ATO",)
        self.receives = ("ODO_Motion",)
        self.period_ns = 10_000_000
        self.probes = (Probe("half", "1"),)
        self.after = ()
        self.outputs = {"ATO_Command": {"EffortDemand": 0.5}}
        self.steps: list[tuple[int, float, int]] = []
        self.on_step = lambda: None
        for key, value in changes.items():
            setattr(self, key, value)

    def step(self, now_ns, inbox, outbox) -> None:
        seen = inbox[self.receives[0]]
        self.steps.append((now_ns, seen.values.get("Position", 0.0), seen.age_ns()))
        self.timing = inbox.timing
        for name, values in self.outputs.items():
            outbox.put(name, values)
        self.on_step()

    def probe(self) -> tuple[float, ...]:
        return (len(self.steps) / 2,)

    def stop(self, outbox) -> None:
        outbox.put("ATO_Command", {"EffortDemand": -1.0, "EmergencyBrake": 1})

    def warm_up(self) -> None:
        self.warm = True


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.load()


@pytest.fixture
def fakes() -> SimpleNamespace:
    return SimpleNamespace(Time=FakeTime, Transport=FakeTransport, Unit=FakeUnit)


@pytest.fixture
def protected(contract):
    """A sender of one protected message: call it with SI values for the next frame's payload."""

    def sender(name):
        codec = contract.message(name)
        protector = Protector(codec.protection)

        def frame(**values) -> bytes:
            data = codec.encode(values)
            protector.protect(data)
            return bytes(data)

        return frame

    return sender
