"""What the local bus adds to python-can's interface, and how it refuses what is wrong."""

from __future__ import annotations

import itertools
import socket
import sys
import threading

import can
import pytest

from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.canbus.local.client import HilBus
from hil.canbus.local.wire import HEADER

WAIT_S = 10.0


@pytest.fixture
def bus(channel):
    opened = []

    def open_bus(**options):
        opened.append(HilBus(channel, **options))
        return opened[-1]

    yield open_bus
    for each in opened:
        each.shutdown()


def test_interface_is_registered_with_python_can(channel):
    with can.Bus(interface="hil", channel=channel) as bus:
        assert isinstance(bus, HilBus)
        assert str(bus) == f"hil channel '{channel}'"


def test_number_is_a_channel_name_too(channel):
    with can.Bus(interface="hil", channel=int(channel[-6:], 16)) as bus:
        assert bus.channel == str(int(channel[-6:], 16))


def test_raw_frames_and_messages_are_the_same_on_the_bus(bus):
    raw, plain = bus(fd=True), bus(fd=True)
    raw.send_raw(0x181, b"\x01\x02")
    raw.send_raw(EXTENDED_ID_FLAG | 0x181, bytearray(8))
    raw.send_raw(0x18181, b"")
    raw.send_raw(0x182, bytes(64))
    received = [plain.recv(WAIT_S) for _ in range(4)]
    assert [(m.arbitration_id, m.is_extended_id, m.is_fd, bytes(m.data)) for m in received] == [
        (0x181, False, False, b"\x01\x02"),
        (0x181, True, False, bytes(8)),
        (0x18181, True, False, b""),
        (0x182, False, True, bytes(64)),
    ]
    for message in received:
        plain.send(message)
    frames = []
    while len(frames) < 4:
        frames += raw.drain_raw()
    assert [(frame.can_id, frame.data) for frame in frames] == [
        (0x181, b"\x01\x02"),
        (EXTENDED_ID_FLAG | 0x181, bytes(8)),
        (EXTENDED_ID_FLAG | 0x18181, b""),
        (0x182, bytes(64)),
    ]
    assert all(type(frame) is Frame and type(frame.data) is bytes for frame in frames)


def test_raw_receiver_leaves_out_remote_frames_and_counts_error_frames(bus):
    sender, drained, waited = bus(), bus(), bus()
    sender.send(can.Message(arbitration_id=1, is_remote_frame=True, dlc=2))
    sender.send(can.Message(arbitration_id=4, is_error_frame=True, data=bytes(8)))
    sender.send_raw(0x10, b"x")
    assert waited.recv_raw(WAIT_S).can_id == 0x10
    assert [frame.can_id for frame in drained.drain_raw()] == [0x10]
    assert (drained.error_frames, waited.error_frames) == (1, 1)
    assert drained.drain_raw() == []
    assert waited.recv_raw(0) is None


def test_drain_takes_everything_that_waits(bus):
    sender, receiver = bus(), bus()
    for n in range(10_000):  # several times what one read takes
        sender.send_raw(0x100, n.to_bytes(8, "little"), None)
    sender.send_raw(0x101, b"", None)
    frames = []
    while not frames or frames[-1].can_id != 0x101:
        frames += receiver.drain_raw()
    assert [int.from_bytes(frame.data, "little") for frame in frames[:-1]] == list(range(10_000))
    stamps = [frame.timestamp_ns for frame in frames]
    assert all(a < b for a, b in itertools.pairwise(stamps))


def test_one_drain_takes_more_than_one_read(bus, monkeypatch):
    near, far = socket.socketpair()
    near.setblocking(False)
    receiver = bus()
    with near, far, monkeypatch.context() as patched:
        patched.setattr(receiver._stream, "_sock", near)
        far.sendall(b"".join(HEADER.pack(n, 0x100, 8, 0, 8) + bytes(8) for n in range(4000)))  # 96,000 bytes
        assert [frame.timestamp_ns for frame in receiver.drain_raw()] == list(range(4000))


def test_mixed_ways_of_receiving_lose_nothing(bus):
    sender, receiver = bus(), bus()
    for n in range(300):
        sender.send_raw(0x100, n.to_bytes(8, "little"), None)
    received = []
    while len(received) < 300:
        received.append(receiver.recv_raw(WAIT_S).data)
        received.append(bytes(receiver.recv(WAIT_S).data))
        if len(received) > 200:
            received += [frame.data for frame in receiver.drain_raw()]
    assert [int.from_bytes(data, "little") for data in received] == list(range(300))


def test_bus_without_fd_neither_sends_nor_receives_fd_frames(bus):
    classic, modern, other = bus(), bus(fd=True), bus(fd=True)
    modern.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(20)))
    modern.send(can.Message(arbitration_id=2, data=bytes(2)))
    assert classic.recv(WAIT_S).arbitration_id == 2
    assert [other.recv(WAIT_S).arbitration_id for _ in range(2)] == [1, 2]
    assert classic.protocol == can.CanProtocol.CAN_20
    assert modern.protocol == can.CanProtocol.CAN_FD
    with pytest.raises(can.CanOperationError, match="CAN FD frames need the option fd=True"):
        classic.send(can.Message(is_fd=True))
    with pytest.raises(ValueError, match="9 data bytes; 8 fit, 64 with CAN FD"):
        classic.send_raw(1, bytes(9))


@pytest.mark.parametrize(
    "wrong",
    [
        {"arbitration_id": 0x800, "is_extended_id": False},
        {"arbitration_id": 0x20000000},
        {"arbitration_id": -1},
        {"data": bytes(9)},
        {"is_fd": True, "data": bytes(65)},
        {"is_remote_frame": True, "dlc": 9},
    ],
)
def test_impossible_message_is_refused_and_nothing_is_sent(bus, wrong):
    sender, receiver = bus(fd=True), bus(fd=True)
    with pytest.raises(can.CanOperationError):
        sender.send(can.Message(**wrong))
    sender.send(can.Message(arbitration_id=5))
    assert receiver.recv(WAIT_S).arbitration_id == 5


def test_length_decides_where_data_do_not_fit_it(bus):
    sender, receiver = bus(), bus()
    sender.send(can.Message(arbitration_id=1, dlc=4, data=b"ab"))
    sender.send(can.Message(arbitration_id=1, dlc=1, data=b"ab"))
    assert [bytes(receiver.recv(WAIT_S).data) for _ in range(2)] == [b"ab\0\0", b"a"]


def test_error_frames_pass_filters_as_on_socketcan(bus):
    sender, receiver = bus(), bus(can_filters=[{"can_id": 0x123, "can_mask": 0x7FF}])
    sender.send(can.Message(arbitration_id=0x4, is_error_frame=True, data=bytes(8)))
    assert receiver.recv(WAIT_S).is_error_frame


def test_own_frames_stand_where_all_others_see_them(bus):
    first = bus(receive_own_messages=True, can_filters=[{"can_id": 0x100, "can_mask": 0x700}])
    second, observer = bus(receive_own_messages=True), bus()

    def send(each, start):
        for n in range(start, start + 300):
            each.send_raw(0x100, n.to_bytes(8, "little"), None)

    threads = [
        threading.Thread(target=send, args=(first, 0)),
        threading.Thread(target=send, args=(second, 1000)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    seen = [[each.recv_raw(WAIT_S) for _ in range(600)] for each in (first, second, observer)]
    assert seen[0] == seen[1] == seen[2]


def test_new_filters_hold_for_every_frame_sent_after_the_call(bus):
    sender, receiver = bus(), bus()
    for n in range(200):
        receiver.set_filters([{"can_id": n, "can_mask": 0x7FF}])
        sender.send_raw(n, b"")
        sender.send_raw(n + 1, b"")
        assert receiver.recv_raw(WAIT_S).can_id == n
    assert receiver.recv_raw(0.05) is None


def test_frames_that_wait_when_filters_change_are_kept(bus):
    sender, receiver = bus(), bus()
    for n in range(100):
        sender.send_raw(0x100, bytes([n]))
    barrier = bus(receive_own_messages=True)
    barrier.send_raw(0x101, b"")
    while barrier.recv_raw(WAIT_S).can_id != 0x101:
        pass
    receiver.set_filters([{"can_id": 0x200, "can_mask": 0x7FF}])
    assert [receiver.recv(WAIT_S).data[0] for _ in range(100)] == list(range(100))


def test_too_many_filters_are_refused(bus):
    with pytest.raises(can.CanOperationError, match="too many filters"):
        bus().set_filters([{"can_id": n, "can_mask": 0x7FF} for n in range(10_000)])


def test_threads_may_send_on_one_bus(bus):
    sender, receiver = bus(), bus()

    def send(can_id):
        for n in range(500):
            sender.send_raw(can_id, n.to_bytes(2, "little"), None)

    threads = [threading.Thread(target=send, args=(can_id,)) for can_id in range(4)]
    for thread in threads:
        thread.start()
    received = {can_id: [] for can_id in range(4)}
    for _ in range(2000):
        frame = receiver.recv_raw(WAIT_S)
        received[frame.can_id].append(int.from_bytes(frame.data, "little"))
    for thread in threads:
        thread.join()
    assert all(numbers == list(range(500)) for numbers in received.values())


def test_shutdown_wakes_a_thread_that_waits(bus):
    waiting = bus()
    caught = []

    def wait():
        try:
            waiting.recv(None)
        except can.CanOperationError as error:
            caught.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    waiting.shutdown()
    thread.join(WAIT_S)
    assert not thread.is_alive()
    assert caught
    assert "was shut down here" in caught[0]


@pytest.mark.parametrize("name", ["a/b", "", ".hidden", "with space", "../x"])
def test_name_that_is_no_channel_is_refused(name):
    with pytest.raises(can.CanInitializationError, match="a name starts with a letter") as caught:
        HilBus(name)
    assert "\n" not in str(caught.value)


def test_unknown_option_is_mentioned(channel, caplog):
    HilBus(channel, recieve_own_messages=True, single_handle=True).shutdown()
    assert [record.getMessage() for record in caplog.records] == [
        "interface hil has no option 'recieve_own_messages': ignored"
    ]


# -- where the hub is found --------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="no AF_UNIX path limit")
def test_path_that_is_too_long_is_refused_with_the_remedy(channel, tmp_path, monkeypatch):
    folder = tmp_path / ("x" * 90)
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    with pytest.raises(can.CanInitializationError, match=r"bytes long, the limit is 10\d: choose a shorter"):
        HilBus(channel)


def test_folder_is_the_users_alone(channel, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "hil").mkdir(mode=0o777)
    with HilBus(channel):
        assert (tmp_path / "hil").stat().st_mode & 0o777 == 0o700


def test_folder_falls_back_to_the_temporary_one(channel, tmp_path, monkeypatch):
    from hil.canbus.local import address

    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "missing"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert address.folder().parent == tmp_path
    assert address.folder().name.startswith("hil-")


def test_folder_of_somebody_else_is_refused(channel, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("os.getuid", lambda: 12345)
    with pytest.raises(can.CanInitializationError, match="belongs to somebody else"):
        HilBus(channel)


def test_bus_works_over_tcp_where_there_is_no_unix_socket(channel, monkeypatch):
    from hil.canbus.local import address
    from hil.canbus.local.hub import Hub

    monkeypatch.setattr("hil.canbus.local.address.HAVE_UNIX_SOCKETS", False)
    hub = Hub(channel)
    thread = threading.Thread(target=hub.serve)
    thread.start()
    try:
        with HilBus(channel, autostart=False) as first, HilBus(channel, autostart=False) as second:
            for n in range(1000):
                first.send_raw(0x100, n.to_bytes(8, "little"), None)
            numbers = [int.from_bytes(second.recv_raw(WAIT_S).data, "little") for _ in range(1000)]
            assert numbers == list(range(1000))
            port, secret = address.socket_path(channel).read_text().split()
            address.socket_path(channel).write_text(f"{port} {'0' * len(secret)}")
            with pytest.raises(can.CanInitializationError):
                HilBus(channel, autostart=False)
            first.send_raw(0x101, b"on")
            assert second.recv_raw(WAIT_S).data == b"on"
            hub.stop("the test ends")
            with pytest.raises(can.CanOperationError, match="has ended \\(the test ends\\)"):
                second.recv(None)
    finally:
        hub.stop("the test ends")
        thread.join()


def test_frames_sent_together_arrive_together_in_order(channel: str) -> None:
    with can.Bus(interface="hil", channel=channel) as a, can.Bus(interface="hil", channel=channel) as b:
        a.send_raw_all([(0x100 + number, bytes([number])) for number in range(50)])
        a.send_raw_all([])
        frames = [b.recv_raw(5.0) for _ in range(50)]
        assert [frame.data[0] for frame in frames] == list(range(50))
        assert len({frame.timestamp_ns for frame in frames}) == 50
        assert b.recv_raw(0.0) is None
