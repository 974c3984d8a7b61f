"""python-can's own programs on the local bus, as processes."""

from __future__ import annotations

import signal
import sys

import can
import pytest

from hil.canbus.local import link
from hil.canbus.local.client import HilBus


def clients(channel):
    try:
        return len(link.query(channel)["clients"])
    except OSError:
        return 0


@pytest.mark.skipif(sys.platform == "win32", reason="ends the logger with SIGINT")
def test_can_logger_records_what_is_sent_and_can_player_plays_it(channel, spawn, until, tmp_path):
    channel += "-bus"  # python-can's BLF writer takes trailing digits for a channel number, at most 65,534
    sent = [
        can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01\x02\x03"),
        can.Message(arbitration_id=0x18181, is_extended_id=True, data=bytes(8)),
        can.Message(
            arbitration_id=0x281, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(64)
        ),
        can.Message(arbitration_id=0x381, is_extended_id=False, is_remote_frame=True, dlc=4),
    ]
    log = tmp_path / "out.blf"
    logger = spawn("-m", "can.logger", "-i", "hil", "-c", channel, "--fd", "-b", "500000", "-f", str(log))
    until(lambda: clients(channel) == 1, "the logger has joined")
    with HilBus(channel, fd=True) as bus:
        for message in sent:
            bus.send(message)
        barrier = HilBus(channel, receive_own_messages=True)
        barrier.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
        barrier.shutdown()
        until(lambda: bus.recv(0) is not None, "the last frame has passed the hub")
        until(
            lambda: link.query(channel)["clients"][0]["unread_bytes"] == 0, "the logger has read everything"
        )
        _, out, err = logger.end(signal.SIGINT)
        assert "Traceback" not in err, err
        assert f"Connected to HilBus: hil channel '{channel}'" in out
        logged = list(can.LogReader(log))
        assert len(logged) >= 4  # the interrupt may come before it has written the barrier
        for wanted, found in zip(sent, logged, strict=False):
            assert found.equals(wanted, timestamp_delta=None, check_channel=False), (wanted, found)
        player = spawn("-m", "can.player", "-i", "hil", "-c", channel, "--fd", str(log))
        for wanted in sent:
            played = bus.recv(20.0)
            assert played.equals(wanted, timestamp_delta=None, check_channel=False), (wanted, played)
        player.end()
