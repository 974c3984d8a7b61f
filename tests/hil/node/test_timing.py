"""Timing ring: what the reader gets, what it loses, and that it needs no living writer."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from hil.node import CYCLE_FIELDS, Probe, RingError, TimingReader, TimingRing, ring_directory

PROBES = (Probe("speed", "m/s"), Probe("disturbance", "m/s^2"))


def record(k):
    return (k, k * 10, k * 10 + 1, k * 10 + 2, k * 10 + 3, k * 10 + 4, k * 10 + 5, k % 3, k / 2, -float(k))


@pytest.fixture
def ring(tmp_path):
    with TimingRing(
        tmp_path / "ring", name="unit", period_ns=10_000_000, probes=PROBES, capacity=16,
        realtime_offset_ns=123, clock="lockstep",
    ) as ring:  # fmt: skip
        yield ring


def append(ring, ks):
    for k in ks:
        ring.append(*record(k))


def test_header_says_who_wrote_what(ring):
    header = TimingReader.open(ring.path).header
    assert (header.name, header.clock, header.period_ns) == ("unit", "lockstep", 10_000_000)
    assert (header.realtime_offset_ns, header.capacity, header.pid) == (123, 16, os.getpid())
    assert header.probes == (("speed", "m/s"), ("disturbance", "m/s^2"))


def test_reader_gets_every_field_of_every_record_once(ring):
    reader = TimingReader.open(ring.path)
    assert len(reader.read_new()) == 0
    append(ring, range(5))
    records = reader.read_new()
    assert records.dtype.names == (*CYCLE_FIELDS, "speed", "disturbance")
    assert [tuple(row) for row in records.tolist()] == [record(k) for k in range(5)]
    assert len(reader.read_new()) == 0
    assert reader.lost == 0


def test_records_survive_the_wrap_around(ring):
    reader = TimingReader.open(ring.path)
    got = []
    for start in range(0, 100, 7):
        append(ring, range(start, start + 7))
        got += reader.read_new()["cycle"].tolist()
    assert got == list(range(105))
    assert reader.lost == 0


def test_overwritten_records_are_counted_as_lost(ring):
    reader = TimingReader.open(ring.path)
    append(ring, range(4))
    assert len(reader.read_new()) == 4
    append(ring, range(4, 54))
    cycles = reader.read_new()["cycle"].tolist()
    # One slot less than the capacity: the writer may be at work in the oldest one.
    assert cycles == list(range(39, 54))
    assert reader.lost == 35
    append(ring, range(54, 58))
    assert reader.read_new()["cycle"].tolist() == list(range(54, 58))
    assert reader.lost == 35


def test_records_overwritten_during_the_copy_are_left_out(ring, monkeypatch):
    reader = TimingReader.open(ring.path)
    append(ring, range(16))
    written = iter([12, 20])  # the index before the copy, and after it
    monkeypatch.setattr(TimingReader, "written", property(lambda self: next(written)))
    assert reader.read_new()["cycle"].tolist() == list(range(5, 12))
    assert reader.lost == 5


def test_touch_leaves_a_used_ring_alone(ring):
    ring.touch()
    append(ring, range(3))
    ring.touch()
    assert TimingReader.open(ring.path).read_new()["cycle"].tolist() == [0, 1, 2]


def test_reader_works_after_the_writer_was_killed(tmp_path):
    path = tmp_path / "ring"
    script = textwrap.dedent(
        f"""
        import time
        from hil.node import TimingRing
        ring = TimingRing({str(path)!r}, name="victim", period_ns=1, probes=(("value", "1"),), capacity=64)
        for k in range(50):
            ring.append(k, 0, 0, 0, 0, 0, 0, 0, k * 0.5)
        print("written", flush=True)
        time.sleep(60)
        """
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout.readline() == "written\n"
        writer.send_signal(signal.SIGKILL)
    reader = TimingReader.open(path)
    assert reader.read_new()["value"].tolist() == [k * 0.5 for k in range(50)]
    assert reader.header.name == "victim"


def test_concurrent_reader_never_sees_a_torn_record(tmp_path):
    """A writer that laps the reader all the time: every record read is whole, in order, or counted lost."""
    path = tmp_path / "ring"
    count = 60_000
    script = textwrap.dedent(
        f"""
        import sys
        from hil.node import TimingRing
        ring = TimingRing({str(path)!r}, name="writer", period_ns=1, probes=(("p", "1"),), capacity=64)
        print("ready", flush=True)
        sys.stdin.readline()
        for k in range({count}):
            ring.append(k, k, k, k, k, k, k, k, float(k))
        """
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    ) as writer:
        writer.stdout.readline()
        reader = TimingReader.open(path)
        print(file=writer.stdin, flush=True)
        parts = []
        while writer.poll() is None:
            parts.append(reader.read_new())
        parts.append(reader.read_new())
    records = np.concatenate(parts)
    for field in reader.dtype.names[1:]:
        np.testing.assert_array_equal(records[field], records["cycle"])
    assert np.all(np.diff(records["cycle"]) > 0)
    assert len(records) + reader.lost == count


def test_newer_ring_replaces_an_older_one_under_the_same_path(tmp_path):
    for name in ("old", "new"):
        TimingRing(tmp_path / "ring", name=name, period_ns=1, capacity=2).close()
    assert TimingReader.open(tmp_path / "ring").header.name == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["ring"]


@pytest.mark.parametrize("content", [b"", b"HILRING\n", b"x" * 5000])
def test_file_that_is_no_ring_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "ring"
    path.write_bytes(content)
    with pytest.raises(RingError, match="ring") as caught:
        TimingReader.open(path)
    assert "\n" not in str(caught.value)


def test_ring_of_another_version_is_refused(ring):
    content = bytearray(ring.path.read_bytes())
    content[8:12] = (99).to_bytes(4, sys.byteorder)
    ring.path.with_name("other").write_bytes(content)
    with pytest.raises(RingError, match="version 99"):
        TimingReader.open(ring.path.with_name("other"))


def test_truncated_ring_is_refused(ring):
    ring.path.with_name("half").write_bytes(ring.path.read_bytes()[:4200])
    with pytest.raises(RingError, match="damaged"):
        TimingReader.open(ring.path.with_name("half"))


@pytest.mark.parametrize("capacity", [0, 1, 3, 1000])
def test_capacity_must_be_a_power_of_two(tmp_path, capacity):
    with pytest.raises(RingError, match="power of two"):
        TimingRing(tmp_path / "ring", name="n", period_ns=1, capacity=capacity)


def test_probe_must_not_take_the_name_of_another_column(tmp_path):
    with pytest.raises(RingError, match="cycle"):
        TimingRing(tmp_path / "ring", name="n", period_ns=1, probes=[("cycle", "1")])


def test_missing_directory_is_said_in_one_line(tmp_path):
    with pytest.raises(RingError, match="cannot be made") as caught:
        TimingRing(tmp_path / "nowhere" / "ring", name="n", period_ns=1)
    assert caught.value.exit_code == 3


def test_rings_live_where_files_can_be_made():
    assert os.access(ring_directory(), os.W_OK)
