"""Whatever a client says, the hub stays for the others: it removes who speaks nonsense, and only that one."""

from __future__ import annotations

import json
import socket
from uuid import uuid4

import pytest

from hil.canbus.local import address, link, wire
from hil.canbus.local.client import HilBus
from hil.canbus.local.connection import Connection
from hil.canbus.local.hub import Hub
from hil.canbus.local.rates import WireOptions
from hil.canbus.local.wire import CONTROL, HEADER, Control, WireError

WAIT_S = 20.0


@pytest.fixture
def channel():
    return f"i{uuid4().hex[:8]}"


def control(code, text):
    return HEADER.pack(0, code, len(text), CONTROL, 0) + text


@pytest.mark.parametrize(
    "record",
    [
        control(Control.HELLO, b"[" * 60_000),  # deeper than Python's JSON reader goes
        control(Control.HELLO, b'{"protocol":%d,"pid":1e999}' % wire.PROTOCOL_VERSION),
        control(Control.HELLO, b'{"protocol":%d,"pid":1,"filters":[[1e999,1,null]]}' % wire.PROTOCOL_VERSION),
    ],
    ids=["nested", "endless pid", "endless filter"],
)
def test_control_record_that_cannot_be_read_ends_its_sender_alone(channel, start_hub, record):
    start_hub(channel)
    with HilBus(channel) as first, HilBus(channel) as second:
        with address.connect(channel, WAIT_S) as sock:
            sock.sendall(record)
            assert b"could not read" in sock.recv(1000)
        first.send_raw(1, b"on", WAIT_S)
        assert second.recv_raw(WAIT_S).data == b"on"


@pytest.mark.parametrize(
    "wrong",
    [{"can_id": "0x10"}, {"mask": None, "can_id": 1}, {"count": "3"}, {"bit": 1.5}, {"choose": "any"},
     {"probability": "1"}],
    ids=json.dumps,
)  # fmt: skip
def test_disturbance_of_the_wrong_type_is_refused_before_it_meets_a_frame(channel, start_hub, wrong):
    start_hub(channel, "--bitrate", "500000")
    with HilBus(channel) as first, HilBus(channel) as second:
        with pytest.raises(WireError, match="no disturbance"):
            link.disturb(channel, **wrong)
        first.send_raw(1, b"on", WAIT_S)
        assert second.recv_raw(WAIT_S).data == b"on"


def test_frame_of_a_client_that_has_left_may_meet_a_full_backlog(channel):
    """What it sent is on the wire still; the hub then has nobody to hold, and no socket to watch."""
    hub = Hub(channel, timing=WireOptions(500_000))
    near, far = socket.socketpair()
    near.setblocking(False)
    try:
        sender = Connection(near)
        hub._connections[near.fileno()] = sender
        hub._selector.register(near, sender.events, sender)
        sender.introduce(1, {"pid": 1})
        hub._exchange.admit(sender)
        sender.backlog += b"not read"
        hub._remove(sender, None)
        hub._set_events(sender)
        assert sender.events == 0
    finally:
        far.close()
        hub._close("end of the test")
