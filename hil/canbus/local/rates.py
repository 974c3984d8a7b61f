"""Local bus, its bit rate: what a hub is started with, and who cannot join it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

TX_QUEUE_FRAMES = 32
"""A sender is held back when so many of its frames wait for the wire."""

RESTART_MS = 100


@dataclass(frozen=True)
class WireOptions:
    """Bit rate of a channel, and what goes with it."""

    bitrate: int
    """bit/s"""
    data_bitrate: int | None = None
    """bit/s of CAN FD frames with bit-rate switch; None: as `bitrate`."""
    tx_queue_frames: int = TX_QUEUE_FRAMES
    restart_ms: int = RESTART_MS
    """A node that went bus-off is restarted after so long, as with SocketCAN's restart-ms; 0: never."""
    seed: int = 0
    """Of the errors that are made on purpose."""


def refused_bitrate(options: WireOptions | None, hello: dict[str, Any]) -> str | None:
    """Why a client that says `hello` cannot join, in a few words; None: it can.

    Who asks for no bit rate takes what there is.
    """
    asked, asked_data = hello.get("bitrate"), hello.get("data_bitrate")
    if options is None:
        if asked is None:
            return None  # a data bit rate alone is what python-can's configuration hands to every interface
        return f"{asked} bit/s asked for, but the bus has no bit rate; ask for none, or end its hub first"
    if asked is not None and asked != options.bitrate:
        return f"{asked} bit/s asked for, but the bus has {options.bitrate} bit/s; all have to agree"
    if asked_data is not None and asked_data != (options.data_bitrate or options.bitrate):
        has = options.data_bitrate or options.bitrate
        return f"data bit rate {asked_data} bit/s asked for, but the bus has {has} bit/s; all have to agree"
    return None
