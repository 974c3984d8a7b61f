"""Measured load: exact frame lengths, windows, and agreement with the model of the wire."""

import random

import pytest

from hil.canbus.analysis.load import LoadMeter, WireFrame
from hil.canbus.local.bits import INTERFRAME_BITS, frame_bits
from hil.canbus.local.medium import Medium
from hil.canbus.local.medium import WireFrame as ModelFrame

MS = 1_000_000


def test_a_saturated_bus_has_a_load_of_one():
    medium, meter = Medium(500_000), LoadMeter(500_000)
    source = random.Random(1)
    for _ in range(1500):
        medium.submit("a", ModelFrame(source.randrange(0x800), source.randbytes(source.randrange(9))), 0)
    for end_ns, _, frame in medium.advance(10_000 * MS):
        meter.add(WireFrame(end_ns, frame.can_id, bytes(frame.data)))
    assert meter.frames == 1500
    assert meter.wire_ns / meter.span_ns == pytest.approx(1.0, rel=1e-3)
    assert all(window.load == pytest.approx(1.0, abs=1e-3) for window in meter.windows)
    assert sum(message.wire_ns for message in meter.messages.values()) == meter.wire_ns


def test_the_burst_is_the_fullest_window_and_not_the_mean():
    meter = LoadMeter(250_000)
    bits = frame_bits(0x100, bytes(8)).total + INTERFRAME_BITS
    for start_ms in (0, 500):
        for number in range(1 if start_ms == 0 else 12):
            meter.add(WireFrame(start_ms * MS + number * 800_000, 0x100, bytes(8)))
    short, long = meter.windows
    assert short.load == pytest.approx(12 * bits * 4_000 / short.length_ns)
    assert long.load == pytest.approx(12 * bits * 4_000 / long.length_ns)
    assert short.end_ns == 500 * MS + 11 * 800_000


def test_messages_come_with_the_largest_load_first_and_identifiers_of_both_lengths_apart():
    meter = LoadMeter(250_000)
    for number in range(3):
        meter.add(WireFrame(number * MS, 0x10, b""))
        meter.add(WireFrame(number * MS, 0x10, bytes(8), True))
    assert [(m.extended, m.frames) for m in meter.by_load()] == [(True, 3), (False, 3)]


def test_the_data_phase_of_can_fd_counts_at_its_own_rate():
    slow, fast = LoadMeter(500_000), LoadMeter(500_000, 2_000_000)
    for meter in (slow, fast):
        meter.add(WireFrame(0, 0x10, bytes(64), fd=True, brs=True))
    assert 0.25 < fast.wire_ns / slow.wire_ns < 0.4
