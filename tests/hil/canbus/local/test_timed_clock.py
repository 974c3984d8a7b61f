"""The local bus with a bit rate, without processes: its time stamps, and how senders are held back."""

from __future__ import annotations

import contextlib
import socket
from types import SimpleNamespace

import pytest

from hil.canbus.local import stream as stream_module
from hil.canbus.local import timed
from hil.canbus.local.connection import Connection
from hil.canbus.local.credit import sent_record
from hil.canbus.local.rates import WireOptions
from hil.canbus.local.stream import Stream, TransmitQueueFullError
from hil.canbus.local.wire import HEADER, HEADER_SIZE

EPOCH_NS = 1_700_000_000_000_000_000
MS = 1_000_000


class FakeTime:
    """Both clocks; each look takes 100 ns, and the process may be kept from the CPU before some of them."""

    def __init__(self):
        self.now_ns = 5_000_000_000
        self.wall_ns = EPOCH_NS
        self.looks = 0
        self.held_ns = {}

    def _look(self):
        self.now_ns += 100 + self.held_ns.pop(self.looks, 0)
        self.looks += 1
        return self.now_ns

    def monotonic_ns(self):
        return self._look()

    def time_ns(self):
        return self._look() + self.wall_ns

    def hold_up(self, duration_ns, *, looks_from_now):
        self.held_ns[self.looks + looks_from_now] = duration_ns


class Wire:
    """A timed exchange with a sender and a receiver."""

    def __init__(self, time):
        self.time = time
        self.exchange = timed.TimedExchange(1 << 20, lambda client: None, WireOptions(500_000))
        pairs = [socket.socketpair() for _ in range(2)]
        self.sockets = [sock for pair in pairs for sock in pair]
        for sock in self.sockets:
            sock.setblocking(False)
        self.sender, self.receiver = (Connection(near) for near, _ in pairs)
        self._far = pairs[1][1]
        for number, client in enumerate((self.sender, self.receiver), 1):
            client.introduce(number, {"pid": 1})
            self.exchange.admit(client)

    def send(self):
        """Send a frame, let it pass, and return its time stamp on the monotonic clock."""
        record = bytearray(HEADER.pack(0, 0x10, 1, 0, 1) + b"x")
        self.exchange.forward(self.sender, record, 1, 0, with_fd=False)
        self.time.now_ns += MS
        self.exchange.advance()
        got = self._far.recv(1000)
        assert len(got) == HEADER_SIZE + 1
        return HEADER.unpack_from(got)[0]


@pytest.fixture
def wire(monkeypatch):
    made = []

    def make(time=None):
        time = time or FakeTime()
        monkeypatch.setattr(timed, "time", time)
        made.append(Wire(time))
        return made[-1]

    yield make
    for one in made:
        for sock in one.sockets:
            sock.close()


@pytest.mark.parametrize("look", range(1, 5))
def test_hub_that_is_held_up_between_two_looks_at_the_clocks_stamps_as_before(wire, look):
    bus = wire()
    before = bus.send()
    bus.time.hold_up(5 * MS, looks_from_now=look)  # the first look says when the frame was queued
    queued_ns = bus.time.now_ns + EPOCH_NS
    stamp = bus.send()
    assert before < queued_ns < stamp < queued_ns + MS
    assert stamp < bus.send()


@pytest.mark.parametrize("look", range(2))
def test_hub_that_is_held_up_while_it_starts_stamps_no_frame_wrong(wire, look):
    time = FakeTime()
    time.hold_up(MS - 200, looks_from_now=look)
    bus = wire(time)
    stamp = bus.send()
    assert 0 < bus.time.now_ns + EPOCH_NS - stamp < MS


def test_step_of_the_wall_clock_is_followed_when_the_bus_is_idle(wire):
    bus = wire()
    bus.send()
    bus.time.wall_ns += 30 * MS
    stamp = bus.send()
    assert 0 < bus.time.now_ns + EPOCH_NS + 30 * MS - stamp < 2 * MS


def test_small_step_back_of_the_wall_clock_does_not_turn_the_order_of_stamps(wire):
    bus = wire()
    before = bus.send()
    bus.time.wall_ns -= 30 * MS
    stamps = [before, *(bus.send() for _ in range(60))]
    assert stamps == sorted(set(stamps))
    assert 0 < bus.time.now_ns + EPOCH_NS - 30 * MS - stamps[-1] < 2 * MS


# -- the sender's side ------------------------------------------------------------------------------------


@pytest.fixture
def sender(monkeypatch):
    """A client of a bus with a bit rate and a queue of 4 frames; the test plays the hub."""
    near, hub = socket.socketpair()
    near.setblocking(False)
    welcome = {"number": 1, "pid": 1, "bitrate": 500_000, "tx_queue": 4}
    monkeypatch.setattr(stream_module.link, "join", lambda *given, **options: (near, welcome))
    monkeypatch.setattr(stream_module.link, "query", lambda *given: {"clients": [], "pid": 1, "removed": []})
    stream = Stream("test", {}, autostart=False)
    yield SimpleNamespace(stream=stream, hub=hub)
    stream.close()
    hub.close()


FRAME = HEADER.pack(0, 0x10, 1, 0, 1) + b"x"


def test_frame_that_the_hub_did_not_take_waits_for_no_wire(sender):
    stream = sender.stream
    stream.fileno()  # who watches it is held by the hub alone, by a full socket
    with contextlib.suppress(TransmitQueueFullError):
        for _ in range(1000):
            stream.send(FRAME * 100, 0.0)
    sender.hub.setblocking(False)
    arrived = 0
    with contextlib.suppress(BlockingIOError):
        while chunk := sender.hub.recv(1 << 20):
            arrived += len(chunk)
    assert 0 < arrived < 100_000 * len(FRAME)
    assert stream.credit.pending == arrived // len(FRAME)


def test_sender_that_never_reads_does_not_hoard_what_others_send(sender, monkeypatch):
    monkeypatch.setattr(stream_module, "_AHEAD_BYTES", 4096)
    stream, hub = sender.stream, sender.hub
    sent = 0
    for _ in range(60):
        hub.sendall(FRAME * 20)
        for _ in range(4):
            stream.send(FRAME, 0.0)
            sent += 1
        hub.sendall(sent_record(sent))
        hub.recv(1 << 16)
    assert len(stream._buffer) <= 2 * 4096
    # All that was sent to it is still there, in order, once it reads.
    assert len(stream.drain()) == 1200
