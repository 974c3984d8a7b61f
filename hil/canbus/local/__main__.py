"""Local bus, the hub as a process: `python -m hil.canbus.local --channel ato`."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from hil.canbus.local.address import AddressError, ChannelTakenError
from hil.canbus.local.hub import HIGH_WATER_BYTES, STALL_LIMIT_S, Hub
from hil.canbus.local.rates import RESTART_MS, TX_QUEUE_FRAMES, WireOptions

EXIT_BAD_INPUT = 2

LONGEST_LINGER_S = 7 * 24 * 3600
"""A selector cannot sleep for any time: epoll takes 24 days at most."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the hub of one channel; 0: ended in order, or the channel has a hub already; 2: bad input."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        timing = _timing(arguments)
    except ValueError as error:
        parser.error(str(error))
    try:
        hub = Hub(
            arguments.channel,
            timing=timing,
            linger_s=arguments.linger,
            high_water_bytes=arguments.high_water,
            stall_limit_s=arguments.stall_limit,
        )
    except ChannelTakenError as error:
        print(f"{error}; nothing to do", file=sys.stderr)
        return 0
    except AddressError as error:
        print(error, file=sys.stderr)
        return EXIT_BAD_INPUT
    if arguments.parent_pipe:
        try:
            hub.watch_parent(sys.stdin.fileno())
        except (OSError, ValueError):
            print("--parent-pipe: standard input is not a pipe", file=sys.stderr)
            hub.stop("bad input")
            hub.serve()
            return EXIT_BAD_INPUT
    if arguments.detach:
        log = _detach(hub.claim.path.with_suffix(".log"))
    if arguments.priority:
        _ask_for_priority(arguments.priority)
    # A copy: a signal may still arrive when the hub has closed its own.
    signal.set_wakeup_fd(os.dup(hub.wake_write.fileno()), warn_on_full_buffer=False)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _: hub.stop(signal.Signals(received).name))
    if not arguments.detach:
        with contextlib.suppress(OSError):
            print(f"ready: hub of channel '{hub.channel}', process {os.getpid()}", flush=True)
    hub.serve()
    if arguments.detach and log.stat().st_size == 0:
        log.unlink()
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m hil.canbus.local", description="Hub of one channel of the local bus."
    )
    parser.add_argument("--channel", "-c", required=True, help="name of the channel")
    parser.add_argument(
        "--bitrate",
        "-b",
        type=int,
        metavar="BIT/S",
        help="frames take their time on the wire (default: they go as fast as they can)",
    )
    parser.add_argument(
        "--data-bitrate", type=int, metavar="BIT/S", help="of CAN FD frames with bit-rate switch"
    )
    parser.add_argument(
        "--tx-queue",
        type=int,
        default=TX_QUEUE_FRAMES,
        metavar="FRAMES",
        help="with a bit rate: a sender is held when so many of its frames wait (default %(default)s)",
    )
    parser.add_argument(
        "--restart-ms",
        type=int,
        default=RESTART_MS,
        metavar="MS",
        help="with a bit rate: a node that went bus-off is restarted after so long, 0: never"
        " (default %(default)s)",
    )
    parser.add_argument(
        "--linger", type=_linger_s, metavar="S", help="end this many seconds after the last client left"
    )
    parser.add_argument(
        "--priority", type=int, metavar="N", help="ask for SCHED_FIFO with this priority (1..99)"
    )
    parser.add_argument(
        "--parent-pipe", action="store_true", help="end when standard input, a pipe of the parent, is closed"
    )
    parser.add_argument(
        "--detach", action="store_true", help="listen, then go to the background (not on Windows)"
    )
    parser.add_argument(
        "--high-water",
        type=int,
        default=HIGH_WATER_BYTES,
        metavar="BYTES",
        help="senders are held when so much waits for one client (default %(default)s)",
    )
    parser.add_argument(
        "--stall-limit",
        type=float,
        default=STALL_LIMIT_S,
        metavar="S",
        help="a client that then reads nothing for so long is removed (default %(default)s)",
    )
    return parser


def _linger_s(text: str) -> float:
    """An option in seconds: 0 to a week."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= LONGEST_LINGER_S:
        raise argparse.ArgumentTypeError(
            f"{text}: must be 0 to {LONGEST_LINGER_S} s; leave it out and the hub does not end by itself"
        )
    return value


def _timing(arguments: argparse.Namespace) -> WireOptions | None:
    """What the options say of the wire; ValueError: nothing that makes sense."""
    if arguments.bitrate is None:
        if arguments.data_bitrate is not None:
            raise ValueError("--data-bitrate needs --bitrate")
        return None
    for name, least in (("bitrate", 1), ("data_bitrate", 1), ("tx_queue", 1), ("restart_ms", 0)):
        value = getattr(arguments, name)
        if value is not None and value < least:
            raise ValueError(f"--{name.replace('_', '-')} {value} must be {least} or more")
    return WireOptions(
        arguments.bitrate,
        arguments.data_bitrate,
        tx_queue_frames=arguments.tx_queue,
        restart_ms=arguments.restart_ms,
    )


def _ask_for_priority(priority: int) -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        print(
            f"--priority {priority}: SCHED_FIFO refused ({reason}); going on without. "
            "It needs CAP_SYS_NICE or a limit of rtprio (ulimit -r)",
            file=sys.stderr,
            flush=True,
        )


def _detach(log: Path) -> Path:
    """Leave the terminal and the parent; what the hub has to say goes to `log`."""
    if os.fork():
        os._exit(0)
    os.setsid()
    null = os.open(os.devnull, os.O_RDWR)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o600)
    for number, target in ((0, null), (1, null), (2, output)):
        os.dup2(target, number)
    for number in (null, output):
        if number > 2:
            os.close(number)
    return log


if __name__ == "__main__":
    sys.exit(main())
