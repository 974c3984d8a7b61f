"""The local bus under load: nothing is lost, all see one order, a slow receiver holds back the senders."""

from __future__ import annotations

import os
import signal
import socket
import time

import can
import pytest

from hil.canbus.local import link
from hil.canbus.local.client import HilBus
from hil.canbus.local.connection import Connection
from hil.canbus.local.hub import Hub

WAIT_S = 30.0

SENDER = """
import sys
from hil.canbus.local.client import HilBus
channel, can_id, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
with HilBus(channel, can_filters=[{"can_id": 0x7FF, "can_mask": 0x7FF}]) as bus:
    print("ready", flush=True)
    bus.recv(None)
    for n in range(count):
        bus.send_raw(can_id, n.to_bytes(8, "little"), None)
"""

RECEIVER = """
import hashlib, sys
from hil.canbus.local.client import HilBus
channel, total = sys.argv[1], int(sys.argv[2])
seen, digest, last = {}, hashlib.sha256(), 0
with HilBus(channel) as bus:
    print("ready", flush=True)
    while sum(seen.values()) < total:
        frame = bus.recv_raw(60.0)
        assert frame is not None, f"lost: {total - sum(seen.values())}"
        for stamp, can_id, data in [frame, *bus.drain_raw()]:
            assert stamp > last, "time stamps go back"
            last = stamp
            if can_id == 0x7FF:
                continue
            assert int.from_bytes(data, "little") == seen.get(can_id, 0), f"out of order: {can_id:#x}"
            seen[can_id] = seen.get(can_id, 0) + 1
            digest.update(can_id.to_bytes(2, "little") + data)
print(sum(seen.values()), len(seen), digest.hexdigest(), flush=True)
"""

STOPPED = """
import sys
from hil.canbus.local.client import HilBus
with HilBus(sys.argv[1], name="sleepy") as bus:
    print("ready", flush=True)
    sys.stdin.read()
"""


def fill(bus, limit=1_000_000):
    """Send until the queue is full; how many frames were taken, and the error."""
    for sent in range(limit):
        try:
            bus.send_raw(0x100, sent.to_bytes(8, "little"), 0.3)
        except can.CanOperationError as error:
            return sent, str(error)
    pytest.fail("the queue never got full")
    return None


def fill_and_read(sender, reader):
    """Send until the queue is full because of somebody else, while `reader` reads all."""
    for _ in range(1_000_000):
        try:
            sender.send_raw(0x100, bytes(8), 0.3)
        except can.CanOperationError:
            break
        reader.drain_raw()
    while reader.recv_raw(0.05) is not None:
        pass


def test_burst_of_four_senders_reaches_all_complete_and_in_one_order(channel, start_hub, spawn):
    each, senders = 25_000, 4
    hub = start_hub(channel)
    receivers = [spawn("-c", RECEIVER, channel, str(each * senders)) for _ in range(2)]
    sources = [spawn("-c", SENDER, channel, str(0x100 + k), str(each)) for k in range(senders)]
    for process in (*receivers, *sources):
        process.wait_for_line("ready")
    with HilBus(channel, can_filters=[{"can_id": 0, "can_mask": 0x7FF}]) as starter:
        starter.send_raw(0x7FF, b"")
        results = [receiver.end() for receiver in receivers]
        assert all(source.end()[::2] == (0, "") for source in sources)
        assert starter.statistics()["frames"] == each * senders + 1
    assert [result[2] for result in results] == ["", ""]
    assert results[0][1] == results[1][1]  # same order, same data
    assert results[0][1].startswith(f"{each * senders} {senders} ")
    assert hub.end(signal.SIGTERM)[::2] == (0, "")


def test_sender_is_held_back_and_told_who_is_slow_and_no_frame_is_lost(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    with HilBus(channel, name="slow one") as receiver, HilBus(channel) as sender:
        sent, error = fill(sender)
        assert error.startswith(f"transmit queue full: hil channel '{channel}' took no frame for 0.3 s")
        assert error.endswith(f"too slow in reading: 'slow one' (process {os.getpid()})")
        received = 0
        while received < sent:
            frame = receiver.recv_raw(WAIT_S)
            assert frame is not None
            for _, _, data in [frame, *receiver.drain_raw()]:
                assert int.from_bytes(data, "little") == received
                received += 1
        assert receiver.recv_raw(0.05) is None  # the refused frame was not sent
        sender.send_raw(0x101, b"again")
        assert receiver.recv_raw(WAIT_S).data == b"again"


def test_message_api_is_held_back_the_same_way(channel, start_hub):
    start_hub(channel, "--high-water", "50000")
    message = can.Message(arbitration_id=0x1, is_extended_id=False, data=bytes(8))
    with HilBus(channel) as receiver, HilBus(channel) as sender:
        with pytest.raises(can.CanOperationError, match="transmit queue full"):  # noqa: PT012
            for _ in range(100_000):
                sender.send(message, timeout=0)
        while receiver.drain_raw():
            pass
        sender.send(message, timeout=WAIT_S)


def test_slow_receiver_does_not_hold_back_its_own_frames(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    with HilBus(channel) as slow, HilBus(channel) as sender:
        fill(sender)
        slow.send_raw(0x200, b"here", WAIT_S)
        assert sender.recv_raw(WAIT_S).data == b"here"


def test_slow_receiver_holds_back_only_those_whose_frames_it_wants(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    wanted = [{"can_id": 0x100, "can_mask": 0x7FF}]
    with HilBus(channel, can_filters=wanted) as slow, HilBus(channel) as sender, HilBus(channel) as other:
        fill_and_read(sender, other)
        for n in range(20_000):  # several times the mark, and more than the kernel would keep
            other.send_raw(0x200, n.to_bytes(8, "little"), WAIT_S)
            assert all(frame.can_id == 0x200 for frame in sender.drain_raw())
        stalled = [client["stalled"] for client in other.statistics()["clients"]]
        assert stalled == [True, False, False]
        with pytest.raises(can.CanOperationError, match="transmit queue full"):  # noqa: PT012
            for _ in range(1000):
                sender.send_raw(0x100, bytes(8), 0)
        assert fill(other)[0] > 0  # no more than sockets keep is taken of those that the slow one wants
        assert slow.recv_raw(WAIT_S) is not None


def test_newcomer_may_join_while_others_are_held(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    with HilBus(channel), HilBus(channel) as sender:
        fill(sender)
        with HilBus(channel) as newcomer:
            newcomer.send_raw(0x200, b"new", WAIT_S)
            assert sender.recv_raw(WAIT_S).data == b"new"


def test_burst_on_a_single_processor_is_complete_and_in_order(channel, start_hub, spawn):
    each, senders = 2_500, 4
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})  # the children inherit it
    try:
        start_hub(channel, "--priority", "50")  # taken where it is allowed: then all the more
        receivers = [spawn("-c", RECEIVER, channel, str(each * senders)) for _ in range(2)]
        sources = [spawn("-c", SENDER, channel, str(0x100 + k), str(each)) for k in range(senders)]
    finally:
        os.sched_setaffinity(0, before)
    for process in (*receivers, *sources):
        process.wait_for_line("ready")
    with HilBus(channel, can_filters=[{"can_id": 0, "can_mask": 0x7FF}]) as starter:
        starter.send_raw(0x7FF, b"")
        results = [receiver.end() for receiver in receivers]
    assert [result[2] for result in results] == ["", ""]
    assert results[0][1] == results[1][1]
    assert results[0][1].startswith(f"{each * senders} {senders} ")


def test_stopped_receiver_holds_back_then_goes_on_where_it_was(channel, start_hub, spawn):
    total = 60_000
    start_hub(channel, "--high-water", "200000")
    receiver = spawn("-c", RECEIVER, channel, str(total))
    receiver.wait_for_line("ready")
    receiver.popen.send_signal(signal.SIGSTOP)
    with HilBus(channel) as sender:
        sent, _ = fill(sender)
        assert sent < total
        receiver.popen.send_signal(signal.SIGCONT)
        for n in range(sent, total):
            sender.send_raw(0x100, n.to_bytes(8, "little"), WAIT_S)
        code, out, err = receiver.end()
    assert (code, err) == (0, "")
    assert out.startswith(f"{total} 1 ")


def test_receiver_that_never_reads_is_removed_and_everyone_is_told(channel, start_hub):
    hub = start_hub(channel, "--high-water", "100000", "--stall-limit", "0.5")
    with HilBus(channel, name="sleepy") as sleepy, HilBus(channel) as sender, HilBus(channel) as reader:
        received = 0
        for n in range(20_000):  # goes on as soon as the sleepy one is removed
            sender.send_raw(0x100, n.to_bytes(8, "little"), WAIT_S)
            received += len(reader.drain_raw())
        while received < 20_000:
            assert reader.recv_raw(WAIT_S) is not None
            received += 1
        pending = 0
        with pytest.raises(can.CanOperationError) as caught:  # noqa: PT012
            while True:
                pending += len(sleepy.drain_raw())
        assert 0 < pending < 20_000
        assert (
            f"the hub of channel '{channel}' says: this client was removed: it read nothing for 0.5 s"
            in str(caught.value)
        )
    _, _, err = hub.end(signal.SIGTERM)
    assert err.count("\n") == 1
    assert "client 'sleepy'" in err
    assert "was removed: it read nothing for 0.5 s while" in err


def test_receiver_that_reads_slowly_is_not_removed(channel, start_hub):
    start_hub(channel, "--high-water", "100000", "--stall-limit", "1")
    with HilBus(channel, name="slow") as slow, HilBus(channel, name="sender") as sender:
        fill(sender)
        for _ in range(30):  # for three times the limit, far less than the kernel wants to see free
            for _ in range(30):
                assert slow.recv(WAIT_S) is not None
            time.sleep(0.1)
        assert [client["name"] for client in sender.statistics()["clients"]] == ["slow", "sender"]


def test_killed_receiver_sets_the_senders_free(channel, start_hub, spawn):
    start_hub(channel, "--high-water", "100000")
    receiver = spawn("-c", STOPPED, channel, stdin=-1)
    receiver.wait_for_line("ready")
    with HilBus(channel) as sender:
        fill(sender)
        receiver.popen.kill()
        sender.send_raw(0x100, b"free", WAIT_S)


def test_two_that_only_send_get_an_error_instead_of_a_deadlock(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    with HilBus(channel, name="one") as one, HilBus(channel, name="two") as two:
        fill(one)
        fill(two)
        for bus in (one, two):
            with pytest.raises(can.CanOperationError, match="transmit queue full"):
                bus.send_raw(0x100, b"", 0.0)
        assert one.recv_raw(WAIT_S) is not None
        assert two.recv_raw(WAIT_S) is not None


def test_stopped_hub_is_named_as_the_reason(channel, start_hub):
    hub = start_hub(channel)
    with HilBus(channel) as sender:
        hub.popen.send_signal(signal.SIGSTOP)
        _, error = fill(sender)
        assert error.endswith("its hub does not answer")
        hub.popen.send_signal(signal.SIGCONT)
        sender.send_raw(0x100, b"", WAIT_S)
        assert link.query(channel)["frames"] > 0


def test_backlog_is_bounded_by_the_high_water_mark(channel, start_hub):
    start_hub(channel, "--high-water", "100000")
    with HilBus(channel), HilBus(channel) as first, HilBus(channel) as second:
        fill(first)
        fill(second)
        backlogs = [client["backlog_bytes"] for client in first.statistics()["clients"]]
    assert max(backlogs) < 100_000 + 10 * 32_768  # and one read of each sender beyond it


def test_hub_hands_out_its_backlog_before_it_ends(channel, start_hub):
    hub = start_hub(channel, "--high-water", "100000000")
    with HilBus(channel) as receiver, HilBus(channel) as sender:
        for n in range(30_000):  # more than the kernel keeps between hub and receiver
            sender.send_raw(0x100, n.to_bytes(8, "little"), WAIT_S)
        hub.popen.send_signal(signal.SIGTERM)
        received = []
        with pytest.raises(can.CanOperationError, match="has ended"):  # noqa: PT012
            while True:
                received += receiver.drain_raw()
        hub.end()
    assert [int.from_bytes(frame.data, "little") for frame in received] == list(range(30_000))


def test_stamps_rise_though_the_clock_stands_still_or_steps_back(channel, monkeypatch):
    hub = Hub(channel)
    try:
        client = _member(hub)
        record = bytearray(24)
        record[12] = 8
        stamps = []
        for now_ns in (5_000, 5_000, 4_000, 10_000):
            monkeypatch.setattr("time.time_ns", lambda now_ns=now_ns: now_ns)
            records = record * 2
            hub._digest(client, records)
            stamps += [int.from_bytes(records[k : k + 8], "little") for k in (0, 24)]
        assert stamps == [5_000, 5_001, 5_002, 5_003, 5_004, 5_005, 10_000, 10_001]
    finally:
        hub.stop("test")
        hub.serve()


def _member(hub):
    client = Connection(socket.socket())
    client.number = 1
    return client
