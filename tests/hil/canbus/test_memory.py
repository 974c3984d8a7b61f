from hil.canbus.memory import MemoryChannel


def test_frames_reach_every_other_link_in_order_and_not_the_sender():
    channel = MemoryChannel()
    a, b, c = channel.link(), channel.link(), channel.link()
    for number in range(5):
        a.send(0x100 + number, bytes([number]))
    assert a.drain() == []
    assert [frame.data[0] for frame in b.drain()] == list(range(5))
    assert [frame.can_id for frame in c.drain()] == [0x100 + number for number in range(5)]
    assert b.drain() == []
    assert (a.sent, b.received) == (5, 5)


def test_a_link_keeps_only_the_identifiers_it_receives():
    channel = MemoryChannel()
    a, b = channel.link(), channel.link([0x10])
    a.send_all([(0x10, b"x"), (0x11, b"y"), (0x10, b"z")])
    assert [frame.data for frame in b.drain()] == [b"x", b"z"]


def test_receive_takes_one_and_never_waits():
    channel = MemoryChannel()
    a, b = channel.link(), channel.link()
    a.send(1, b"1")
    a.send(2, b"2")
    assert b.receive(10.0).can_id == 1
    assert b.receive(10.0).can_id == 2
    assert b.receive(10.0) is None


def test_a_frame_keeps_its_bytes_when_the_sender_reuses_the_buffer():
    channel = MemoryChannel()
    a, b = channel.link(), channel.link()
    buffer = bytearray(b"one")
    a.send(1, buffer)
    buffer[:] = b"two"
    assert b.drain()[0].data == b"one"
