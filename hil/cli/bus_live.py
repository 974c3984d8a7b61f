"""A live bus for looking at: python-can's options, opened with one-line errors, and frames as they come."""

from __future__ import annotations

import argparse
import logging
import time
from collections.abc import Iterator

import can

from hil.canbus.errors import BusLost, BusOptionsError, BusUnavailable
from hil.canbus.options import LOCAL_INTERFACE, BusOptions, options_from_namespace

NS_PER_S = 1_000_000_000
LOOK_S = 0.2
"""How long to wait for a frame before looking at the clock again."""


def live_options(
    interface: str | None,
    channel: str | None,
    bitrate: int | None,
    *,
    fd: bool,
    data_bitrate: int | None = None,
) -> BusOptions:
    """The bus that the options name, as python-can resolves them. BusOptionsError, BusUnavailable."""
    return options_from_namespace(
        argparse.Namespace(
            interface=interface, channel=channel, bitrate=bitrate, fd=fd or None, data_bitrate=data_bitrate
        )
    )


def open_live(options: BusOptions, name: str) -> can.BusABC:
    """The bus, to listen to all of it. Raises BusUnavailable, BusOptionsError."""
    keywords = dict(options.extra)
    if options.bitrate is not None:
        keywords["bitrate"] = options.bitrate
    # Whoever listens wants to see CAN FD frames too; other interfaces may refuse what they do not have.
    if options.fd or options.interface == LOCAL_INTERFACE:
        keywords["fd"] = True
    if options.interface == LOCAL_INTERFACE:
        keywords["name"] = name
    logging.getLogger("can").addHandler(logging.NullHandler())  # errors are told once, in one line
    try:
        return can.Bus(options.channel, options.interface, ignore_config=True, **keywords)
    except (can.CanError, OSError, ImportError, NotImplementedError) as error:
        text = _one_line(error)
        if options.interface != LOCAL_INTERFACE:
            text = f"{options}: {text}; 'hil doctor' says what it needs, or use the local bus: -i hil -c ato"
        raise BusUnavailable(text) from None
    except (ValueError, TypeError) as error:
        raise BusOptionsError(f"{options}: {_one_line(error)}") from None


def messages(bus: can.BusABC, seconds: float | None) -> Iterator[can.Message | None]:
    """What arrives within `seconds` (None: until interrupted); None now and then while nothing does.

    Raises BusLost when the bus ends.
    """
    end = None if seconds is None else time.monotonic() + seconds
    while True:
        wait = LOOK_S if end is None else min(LOOK_S, end - time.monotonic())
        if wait <= 0.0:
            return
        try:
            yield bus.recv(wait)
        except can.CanError as error:
            raise BusLost(_one_line(error)) from None


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
