"""A busy bus for as long as one likes: no frame is lost, and the memory of the recorder does not grow."""

import sys
import time
from pathlib import Path

import can
import pytest

from hil.canbus.frame import Frame
from hil.canbus.protection import Protector
from hil.node.inbox import bus_identifier
from hil.record import Recorder, RecorderOptions

FRAMES_A_SECOND = 10_000
WARM_S, MORE_S = 5, 25


def resident_mib():
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    raise AssertionError("no VmRSS")


def traffic(contract):
    """One round of all cyclic messages after the other, counters and CRCs as they should be."""
    rounds = []
    for codec in contract.messages.values():
        if codec.cycle_ns is not None:
            protector = Protector(codec.protection) if codec.protection else None
            frames = []
            for _ in range(60):
                data = codec.encode(dict(codec.start_values))
                if protector is not None:
                    protector.protect(data)
                frames.append((bus_identifier(codec), bytes(data)))
            rounds.append(frames)
    return [frames[k] for k in range(60) for frames in rounds]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_ten_thousand_frames_a_second_are_all_kept_and_memory_stays_flat(tmp_path, contract):
    sent = traffic(contract)
    start_ns, number, sizes = time.time_ns(), 0, []
    with Recorder(contract, RecorderOptions(directory=tmp_path, clock="realtime")) as recorder:
        for second in range(WARM_S + MORE_S):
            for _ in range(10):
                block = []
                for _ in range(FRAMES_A_SECOND // 10):
                    can_id, data = sent[number % len(sent)]
                    block.append(Frame(start_ns + number * 1_000_000_000 // FRAMES_A_SECOND, can_id, data))
                    number += 1
                recorder.feed(block)
            recorder.flush()
            if second in (WARM_S - 1, WARM_S + MORE_S - 1):
                sizes.append(resident_mib())
        statistics = recorder.close()
    assert statistics.frames == number
    assert statistics.malformed_frames == 0
    # With a footer of every piece in memory it was 15 MiB, and for ever more.
    assert sizes[1] - sizes[0] < 8.0
    with can.LogReader(tmp_path / "frames.blf") as log:
        assert sum(1 for _ in log) == number
