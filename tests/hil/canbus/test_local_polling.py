"""When waiting polls, and that the hub's own selector answers as the standard library's."""

from __future__ import annotations

import os
import selectors
import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.local import polling
from hil.canbus.local.client import HilBus
from hil.canbus.local.hub import Hub
from hil.canbus.local.polling import (
    MAX_SHORT_WAITS,
    POLL_NS,
    SHORT_WAITS,
    WORTH_WAITS,
    Epoll,
    Polling,
    may_poll,
)

WAIT_S = 30.0
SHORT_NS, LONG_NS = POLL_NS // 10, POLL_NS * 50

needs_linux = pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="needs Linux")


@pytest.fixture
def allowed(monkeypatch):
    monkeypatch.setattr(polling, "may_poll", lambda: True)


def short_waits_until_polling(waits):
    for count in range(1, 2 * MAX_SHORT_WAITS):
        waits.waited(SHORT_NS)
        if waits.limit_ns:
            return count
    return None


def test_polling_begins_after_short_waits_in_a_row_and_ends_with_a_long_one(allowed):
    waits = Polling()
    for _ in range(SHORT_WAITS - 1):
        waits.waited(SHORT_NS)
    waits.waited(LONG_NS)
    assert short_waits_until_polling(waits) == SHORT_WAITS
    assert waits.limit_ns == POLL_NS
    waits.waited(LONG_NS)
    assert waits.limit_ns == 0


def test_polling_in_vain_asks_for_twice_as_much_until_it_pays_again(allowed):
    waits = Polling()
    needed = []
    for _ in range(12):
        needed.append(short_waits_until_polling(waits))
        waits.waited(LONG_NS)
    assert needed[:4] == [SHORT_WAITS, 2 * SHORT_WAITS, 4 * SHORT_WAITS, 8 * SHORT_WAITS]
    assert needed[-1] == MAX_SHORT_WAITS
    short_waits_until_polling(waits)
    for _ in range(WORTH_WAITS):
        waits.waited(SHORT_NS)
    waits.waited(LONG_NS)
    assert short_waits_until_polling(waits) == SHORT_WAITS


@given(burst=st.integers(1, SHORT_WAITS - 1), cycles=st.integers(1, 200))
def test_cyclic_traffic_with_pauses_never_polls(burst, cycles):
    waits = Polling()
    for _ in range(cycles):
        for _ in range(burst):
            waits.waited(SHORT_NS)
            assert waits.limit_ns == 0
        waits.waited(LONG_NS)


def test_without_the_right_nothing_polls(monkeypatch):
    monkeypatch.setattr(polling, "may_poll", lambda: False)
    assert short_waits_until_polling(Polling()) is None


@needs_linux
@pytest.mark.parametrize(
    ("policy", "processors", "may"),
    [("SCHED_FIFO", {0, 1}, True), ("SCHED_RR", {0, 3}, True), ("SCHED_FIFO", {0}, False),
     ("SCHED_OTHER", {0, 1, 2, 3}, False)],
)  # fmt: skip
def test_polling_needs_a_realtime_priority_and_a_second_processor(monkeypatch, policy, processors, may):
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: getattr(os, policy))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: processors)
    assert may_poll() is may


@pytest.mark.parametrize("limit_ns", [0, POLL_NS])
def test_wait_returns_when_readable_at_the_end_and_after_its_timeout(limit_ns):
    near, far = socket.socketpair()
    waits = Polling()
    with near, far:
        near.setblocking(False)
        for _ in range(3):
            waits.limit_ns = limit_ns
            waits.wait_readable(near, 0.002)
            with pytest.raises(BlockingIOError):
                near.recv(1)
            far.send(b"x")
            waits.limit_ns = limit_ns
            waits.wait_readable(near, None)
            assert near.recv(1) == b"x"
        far.close()
        waits.limit_ns = limit_ns
        waits.wait_readable(near, None)
        assert near.recv(1) == b""


@pytest.mark.skipif(not hasattr(selectors, "EpollSelector"), reason="needs epoll (Linux)")
@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from(["send", "fill", "read", "watch", "leave", "close"]),
            st.integers(0, 2),
            st.integers(1, 3),
        ),
        max_size=25,
    )
)
def test_epoll_answers_as_the_standard_selector(steps):
    pairs = [socket.socketpair() for _ in range(3)]
    ours, standard = Epoll(), selectors.EpollSelector()
    watched = set()
    try:
        for near, far in pairs:
            near.setblocking(False)
            far.setblocking(False)
        for step, number, events in steps:
            near, far = pairs[number]
            try:
                if step == "send":
                    far.send(b"x")
                elif step == "fill":
                    while near.send(bytes(65536)):
                        pass
                elif step == "read":
                    near.recv(65536)
                elif step == "close":
                    far.close()
            except OSError:
                pass
            if step == "watch":
                for each in (ours, standard):
                    change = each.modify if number in watched else each.register
                    change(near, events, number)
                watched.add(number)
            elif step == "leave" and number in watched:
                for each in (ours, standard):
                    each.unregister(near)
                watched.remove(number)
            found = [sorted((key.data, ready) for key, ready in each.select(0)) for each in (ours, standard)]
            assert found[0] == found[1]
    finally:
        ours.close()
        standard.close()
        for sock in (sock for pair in pairs for sock in pair):
            sock.close()


def test_round_trips_with_hub_and_clients_polling_are_all_answered(channel, allowed, monkeypatch):
    monkeypatch.setattr(polling, "POLL_NS", 20_000_000)  # three threads of one process are slow
    hub = Hub(channel)
    serving = threading.Thread(target=hub.serve)
    serving.start()

    def answer():
        while (frame := far.recv_raw(WAIT_S)).data:
            far.send_raw(0x200, frame.data)

    polled = set()
    with HilBus(channel, autostart=False) as near, HilBus(channel, autostart=False) as far:
        answering = threading.Thread(target=answer)
        answering.start()
        for n in range(1, 300):
            near.send_raw(0x100, n.to_bytes(8, "little"))
            assert int.from_bytes(near.recv_raw(WAIT_S).data, "little") == n
            for name, waits in (("hub", hub._polling), ("client", near._stream._polling)):
                if waits.limit_ns:
                    polled.add(name)
        near.send_raw(0x100, b"")
        answering.join()
        assert near.recv_raw(0.0) is None
        assert near.recv_raw(0.001) is None
    hub.stop("test")
    serving.join()
    assert polled == {"hub", "client"}
