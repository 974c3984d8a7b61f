"""The restbus in real time, on a fake clock: every frame when it is due, and time laid by the device."""

from __future__ import annotations

from itertools import pairwise

import pytest

from hil.bench.replay.live import Due, Silent, TimeBase, play_live
from hil.canbus.frame import Frame

MS = 1_000_000
EPOCH = 1_700_000_000 * 1_000_000_000
COMMAND, HEARTBEAT, OTHERS = 0x181, 0x701, 0x281


class Bus:
    """A bus with a clock: a device speaks at given times (ns), what is sent is noted."""

    def __init__(self, device, *, send_takes_ns=0, oversleeps_ns=0):
        self.now_ns = 0
        self.sent = []
        self.send_takes_ns, self.oversleeps_ns = send_takes_ns, oversleeps_ns
        self._device = sorted(device)
        self.base = TimeBase(lambda: self.now_ns, lambda: EPOCH + self.now_ns, self.sleep)

    def sleep(self, time_s):
        assert time_s >= 0
        self.now_ns += round(time_s * 1e9) + self.oversleeps_ns

    def send(self, can_id, data):
        self.sent.append((self.now_ns, can_id, bytes(data)))
        self.now_ns += self.send_takes_ns

    def drain(self):
        frames = []
        while self._device and self._device[0][0] <= self.now_ns:
            stamp, can_id = self._device.pop(0)
            frames.append(Frame(EPOCH + stamp, can_id, b"\1"))
        return frames

    def receive(self, timeout_s):
        until = self.now_ns + round(timeout_s * 1e9)
        if self._device and self._device[0][0] <= until:
            stamp, can_id = self._device.pop(0)
            self.now_ns = max(self.now_ns, stamp)
            return Frame(EPOCH + stamp, can_id, b"\1")
        self.now_ns = until
        return None


def never():
    return False


def play(bus, restbus, **keywords):
    given = {"anchors": [COMMAND], "until_ns": 100 * MS, "wait_s": 10.0, "should_stop": never, **keywords}
    return play_live(bus, restbus, base=bus.base, **given)


def cycles(start_ns, count, period_ns=10 * MS):
    return [(start_ns + k * period_ns, COMMAND) for k in range(count)]


def test_frames_go_out_when_they_are_due_after_the_devices_first_cycle():
    start = 3_000 * MS + 123
    bus = Bus([(start - 40 * MS, HEARTBEAT), *cycles(start, 11)])
    live = play(bus, [Due(k * 7 * MS, OTHERS, bytes([k])) for k in range(12)])
    assert [at - start for at, _, _ in bus.sent] == [k * 7 * MS for k in range(12)]
    assert [data for _, _, data in bus.sent] == [bytes([k]) for k in range(12)]
    assert set(live.late_ns) == {0}
    assert live.played_ns == 100 * MS
    assert not live.stopped
    assert [said.time_ns for said in live.said if said.can_id == COMMAND] == [k * 10 * MS for k in range(11)]
    assert live.said[0].time_ns == -40 * MS  # what came before the first cycle is kept, before zero


def test_a_late_frame_is_told_and_does_not_move_those_after_it():
    bus = Bus(cycles(0, 11), send_takes_ns=3 * MS)
    live = play(bus, [Due(20 * MS, OTHERS, b""), Due(21 * MS, OTHERS, b""), Due(60 * MS, OTHERS, b"")])
    assert live.late_ns == [0, 2 * MS, 0]
    assert bus.sent[2][0] == 60 * MS


def test_oversleeping_is_lateness_not_drift():
    bus = Bus(cycles(0, 11), oversleeps_ns=80_000)
    live = play(bus, [Due(k * 10 * MS, OTHERS, b"") for k in range(1, 10)])
    assert live.late_ns == [80_000] * 9


def test_what_waited_for_the_device_goes_out_with_its_first_cycle_in_order():
    bus = Bus(cycles(500 * MS, 11))
    live = play(bus, [Due(-9 * MS, OTHERS, b"a"), Due(-2 * MS, OTHERS, b"b"), Due(1 * MS, OTHERS, b"c")])
    assert [(at, data) for at, _, data in bus.sent] == [
        (500 * MS, b"a"),
        (500 * MS, b"b"),
        (501 * MS, b"c"),
    ]
    assert live.late_ns == [0, 0, 0]


def test_a_frame_that_waited_in_the_buffer_lays_the_time_by_its_stamp():
    bus = Bus(cycles(100 * MS, 11))
    bus.now_ns = 104 * MS  # the launcher was busy when the device spoke
    play(bus, [Due(6 * MS, OTHERS, b"")])
    assert bus.sent[0][0] == 106 * MS


def test_a_stamp_of_another_clock_is_not_taken_for_the_time():
    bus = Bus(cycles(100 * MS, 11))
    bus.base = TimeBase(bus.base.now_ns, lambda: bus.now_ns, bus.base.sleep_s)  # as if stamped 50 years ahead
    play(bus, [Due(6 * MS, OTHERS, b"")])
    assert bus.sent[0][0] == 106 * MS


def test_a_device_that_says_nothing_is_silent():
    bus = Bus([(100 * MS, HEARTBEAT)])
    with pytest.raises(Silent):
        play(bus, [Due(0, OTHERS, b"")], wait_s=2.0)
    assert bus.sent == []
    assert bus.now_ns >= 2_000 * MS


def test_asked_to_stop_it_keeps_what_was_played():
    bus = Bus(cycles(0, 11))
    live = play(
        bus, [Due(k * 10 * MS, OTHERS, b"") for k in range(1, 10)], should_stop=lambda: bus.now_ns >= 35 * MS
    )
    assert live.stopped
    assert live.played_ns == 30 * MS
    assert len(bus.sent) == len(live.late_ns) == 3
    assert len([said for said in live.said if said.can_id == COMMAND]) >= 4


def test_it_ends_where_it_is_told_and_listens_until_then():
    bus = Bus(cycles(0, 40))
    live = play(bus, [Due(k * 10 * MS, OTHERS, b"") for k in range(40)], until_ns=55 * MS)
    assert len(bus.sent) == 6
    assert live.played_ns == 55 * MS
    assert live.said[-1].time_ns == 50 * MS


def test_it_is_shown_how_far_it_is_and_asked_often():
    bus = Bus(cycles(0, 200))
    shares, asked = [], []
    play(
        bus,
        [Due(k * 10 * MS, OTHERS, b"") for k in range(200)],
        until_ns=2_000 * MS,
        show=shares.append,
        should_stop=lambda: asked.append(bus.now_ns),
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(shares) > 3
    assert max(after - before for before, after in pairwise(asked)) <= 60 * MS
