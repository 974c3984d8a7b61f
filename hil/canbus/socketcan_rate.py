"""The bit rate of a SocketCAN interface: set with `ip link`; what a program asks for changes nothing."""

from __future__ import annotations

import json
import shutil
import subprocess

from hil.canbus.errors import BusOptionsError
from hil.canbus.options import BusOptions

__all__ = ["check_bitrate", "interface_bitrate"]

PATIENCE_S = 5.0


def check_bitrate(bus: BusOptions) -> None:
    """Raises BusOptionsError if the interface runs at another bit rate than the one asked for.

    python-can ignores a bit rate on SocketCAN; a user who gave one would measure another bus than they think.
    """
    if bus.interface != "socketcan" or bus.bitrate is None:
        return
    actual = interface_bitrate(bus.channel)
    if actual is not None and actual != bus.bitrate:
        raise BusOptionsError(
            f"-b {bus.bitrate}: {bus.channel} runs at {actual} bit/s; leave -b out, or set it: ip link set"
            f" {bus.channel} down; ip link set {bus.channel} up type can bitrate {bus.bitrate}"
        )


def interface_bitrate(name: str) -> int | None:
    """Nominal bit rate [bit/s]; None: it has none (vcan), there is no such interface, or no iproute2 here."""
    if shutil.which("ip") is None:
        return None
    try:
        told = subprocess.run(
            ["ip", "-json", "-details", "link", "show", "dev", name],
            capture_output=True, text=True, timeout=PATIENCE_S, check=True,
        ).stdout  # fmt: skip
        rate = json.loads(told)[0]["linkinfo"]["info_data"]["bittiming"]["bitrate"]
    except (OSError, subprocess.SubprocessError, ValueError, LookupError, TypeError):
        return None
    return rate if isinstance(rate, int) and rate > 0 else None
