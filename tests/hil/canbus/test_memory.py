import pytest

from hil.canbus.memory import Loss, MemoryChannel


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


def heard(loss, frames=20_000, receivers=1):
    channel = MemoryChannel(loss)
    sender = channel.link()
    links = [channel.link() for _ in range(receivers)]
    for number in range(frames):
        sender.send(0x100 + number % 4, number.to_bytes(4))
    return channel, [[int.from_bytes(frame.data) for frame in link.drain()] for link in links]


def test_frames_are_lost_as_often_as_asked_and_counted():
    channel, (frames,) = heard(Loss(0.01, seed=1))
    assert 140 < 20_000 - len(frames) < 260
    assert channel.lost == 20_000 - len(frames)
    assert frames == sorted(frames)


def test_a_seed_loses_the_same_frames_and_another_seed_others():
    assert heard(Loss(0.05, seed=3))[1] == heard(Loss(0.05, seed=3))[1]
    assert heard(Loss(0.05, seed=3))[1] != heard(Loss(0.05, seed=4))[1]


def test_a_lost_frame_is_lost_for_every_receiver():
    _, (a, b) = heard(Loss(0.2, seed=2), receivers=2)
    assert a == b


def test_spared_identifiers_are_never_lost():
    _, (frames,) = heard(Loss(1.0, seed=1, spared=frozenset({0x102})), frames=400)
    assert frames == list(range(2, 400, 4))


def test_without_a_probability_nothing_is_lost():
    channel, (frames,) = heard(Loss(0.0, seed=1), frames=500)
    assert (channel.lost, len(frames)) == (0, 500)


@pytest.mark.parametrize("probability", [-0.1, 1.5])
def test_a_probability_that_is_none_is_refused(probability):
    with pytest.raises(ValueError, match="must be 0 to 1"):
        Loss(probability, seed=1)
