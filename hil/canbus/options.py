"""Which bus: python-can's own options (`-i -c -b --fd`, can.conf, CAN_INTERFACE …) and the bench's default.

Options given on the command line win over python-can's configuration (`can.rc`, environment, `can.conf`),
which wins over the default: SocketCAN on vcan0 if it is there and up, else the local bus, channel "ato".
"""

from __future__ import annotations

import argparse
import re
import socket
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import can
import can.cli
import can.util

from hil.canbus.errors import BusOptionsError, BusUnavailable

LOCAL_INTERFACE = "hil"
LOCAL_CHANNEL = "ato"
DEFAULT_SOCKETCAN_CHANNEL = "vcan0"

_DEFAULT_CHANNELS = {
    LOCAL_INTERFACE: LOCAL_CHANNEL,
    "socketcan": DEFAULT_SOCKETCAN_CHANNEL,
    "virtual": LOCAL_CHANNEL,
    "udp_multicast": "239.74.163.2",  # python-can's IPv4 group; its IPv6 default needs a route
}
_SIOCGIFFLAGS = 0x8913  # linux/sockios.h
_IFF_UP = 0x1  # linux/if.h
_NAMED = ("interface", "channel", "bitrate", "fd")


@dataclass(frozen=True)
class BusOptions:
    """One bus, as python-can opens it; `extra` are further keyword arguments of its interface."""

    interface: str
    channel: str
    bitrate: int | None = None
    fd: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.interface} channel '{self.channel}'"

    def to_arguments(self) -> list[str]:
        """The command-line arguments that give a child process the same bus; raises BusOptionsError."""
        arguments = ["-i", self.interface, "-c", self.channel]
        if self.bitrate is not None:
            arguments += ["-b", str(self.bitrate)]
        if self.fd:
            arguments.append("--fd")
        keywords = []
        for key, value in self.extra.items():
            if key == "data_bitrate":
                arguments += ["--data-bitrate", str(value)]
            elif key == "timing" and isinstance(value, Mapping):
                arguments += ["--timing", *(f"{name}={number}" for name, number in value.items())]
            elif not isinstance(value, str | int | float) or re.search(r"\s", str(value)):
                raise BusOptionsError(f"bus option {key}={value!r} cannot be handed to another process")
            else:
                keywords.append(f"{key}={value}")
        return [*arguments, "--bus-kwargs", *keywords] if keywords else arguments


def add_bus_arguments(parser: argparse.ArgumentParser) -> None:
    """Add python-can's bus options (`-i -c -b --fd --data-bitrate --timing --bus-kwargs`)."""
    can.cli.add_bus_arguments(
        parser, group_title="bus (python-can; default: vcan0 if up, else local bus 'ato')"
    )


def options_from_namespace(namespace: argparse.Namespace) -> BusOptions:
    """The bus that parsed arguments and python-can's configuration name.

    Raises BusOptionsError for a wrong value, BusUnavailable for an interface that python-can does not know.
    """
    given = {
        key: getattr(namespace, key)
        for key in (*_NAMED, "data_bitrate", "timing")
        if getattr(namespace, key, None) is not None
    }
    return _resolve(given | dict(getattr(namespace, "bus_kwargs", None) or {}))


def default_options() -> BusOptions:
    """The bus when nothing is said: as python-can is configured, else vcan0 if it is up, else local."""
    return _resolve({})


def is_can_interface_up(name: str) -> bool:
    """Whether the kernel has CAN and a network interface `name` that is up."""
    if not has_socketcan():
        return False
    import fcntl

    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock:
            answer = fcntl.ioctl(sock, _SIOCGIFFLAGS, struct.pack("16sH22x", name.encode(), 0))
    except (OSError, struct.error):
        return False
    return bool(struct.unpack_from("16sH", answer)[1] & _IFF_UP)


def has_socketcan() -> bool:
    """Whether this kernel (and this Python) has SocketCAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, AttributeError):
        return False
    return True


def _resolve(given: dict[str, Any]) -> BusOptions:
    try:
        configured = {**can.util.load_file_config(), **can.util.load_environment_config(), **can.rc}
    except (ValueError, TypeError) as error:
        raise BusOptionsError(f"CAN_CONFIG must be a JSON object: {error}") from None
    if "bustype" in configured:
        configured.setdefault("interface", configured["bustype"])
    if not given.get("interface") and not configured.get("interface"):
        named = str(given.get("channel") or configured.get("channel") or DEFAULT_SOCKETCAN_CHANNEL)
        given["interface"] = "socketcan" if is_can_interface_up(named) else LOCAL_INTERFACE
    try:
        merged: dict[str, Any] = dict(can.util.load_config(config=given))
    except can.CanInterfaceNotImplementedError as error:
        raise BusUnavailable(
            f"bus: {error}; python-can has: {', '.join(sorted(can.VALID_INTERFACES))}"
        ) from None
    except (ValueError, TypeError) as error:
        raise BusOptionsError(f"bus options: {error}") from None
    interface = str(merged.pop("interface"))
    channel: Any = merged.pop("channel")
    if channel is None:
        channel = _DEFAULT_CHANNELS.get(interface)
    if channel is None:
        raise BusOptionsError(f"interface '{interface}' needs a channel: -c CHANNEL")
    bitrate = merged.pop("bitrate", None)
    if bitrate is not None and (isinstance(bitrate, bool) or not isinstance(bitrate, int) or bitrate <= 0):
        raise BusOptionsError(f"bitrate {bitrate!r} must be a whole number of bit/s above 0")
    return BusOptions(interface, str(channel), bitrate, bool(merged.pop("fd", False)), merged)
