"""Round trip of a frame between two processes: the local bus beside python-can's own buses, in turns.

All processes have the same SCHED_FIFO priority where the rights are there, and none is pinned. A trip is a
frame to the other process and its answer; rounds of all ways alternate in the same seconds. `virtual` joins
threads of one process only; a bare pair of AF_UNIX sockets is the floor: no hub, and no CAN frame.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import can
import numpy as np

from benchmarks.peers import NO_UDP, ask_for_priority, hil_bus, hub, in_own_network, processor_ns, udp_bus
from benchmarks.rows import Row

ROUNDS, TRIPS, WARM_TRIPS = 8, 400, 100
THERE, BACK = 0x123, 0x124
DATA = b"12345678"
LIMIT_S = 30.0
FRAMES_A_CYCLE = 8
PEERS = {
    "udp_multicast": "python-can udp_multicast",
    "virtual": "python-can virtual, two threads",
    "socket pair": "AF_UNIX socket pair, no hub",
}

Trip = Callable[[], object]


def measure() -> list[Row]:
    found = in_own_network("benchmarks.local_bus")
    rows = []
    for name in ("p50", "p99"):
        times = found[name]
        for way in ("fast path", "can.Message"):
            for peer, peer_is in PEERS.items():
                if name == "p50" or peer == "udp_multicast":
                    is_ = peer_is if peer in times else f"not measured: {peer_is}"
                    rows.append(
                        Row(
                            f"round trip {name}, two processes, {way}", times[way], times.get(peer), "us", is_
                        )
                    )
    for period, percent in found["hub_percent"].items():
        what = f"hub's share of a processor, 2 nodes, {FRAMES_A_CYCLE} frames each, every {period}"
        rows.append(Row(what, percent, None, "%", "-"))
    return rows


def measure_here(*, udp: bool) -> dict[str, Any]:
    """Median and 99th percentile of each way [us]; the hub's share of a processor with a bench's traffic."""
    ask_for_priority()
    with ExitStack() as stack:
        ways = {
            "fast path": stack.enter_context(_hil_raw(f"bench-{os.getpid()}-raw")),
            "can.Message": stack.enter_context(_hil(f"bench-{os.getpid()}")),
            "virtual": stack.enter_context(_virtual()),
            "socket pair": stack.enter_context(_socket_pair()),
        }
        if udp:
            ways["udp_multicast"] = stack.enter_context(_udp())
        times: dict[str, list[int]] = {way: [] for way in ways}
        for trip in ways.values():
            _times_ns(trip, WARM_TRIPS)
        for _ in range(ROUNDS):
            for way, trip in ways.items():
                times[way] += _times_ns(trip, TRIPS)
    quantiles = {
        f"p{percent}": {way: float(np.percentile(each, percent)) / 1000 for way, each in times.items()}
        for percent in (50, 99)
    }
    return quantiles | {"hub_percent": {"10 ms": _hub_percent(0.01), "1 ms": _hub_percent(0.001)}}


def _times_ns(trip: Trip, count: int) -> list[int]:
    times = []
    clock = time.perf_counter_ns
    for _ in range(count):
        start = clock()
        trip()
        times.append(clock() - start)
    return times


@contextmanager
def _hil_raw(channel: str) -> Iterator[Trip]:
    with hub(channel), hil_bus(channel) as bus, _process(_echo_raw, channel):
        bus.recv(LIMIT_S)  # the echo says when it is there

        def trip() -> None:
            bus.send_raw(THERE, DATA)  # type: ignore[attr-defined]
            if bus.recv_raw(LIMIT_S) is None:  # type: ignore[attr-defined]
                raise RuntimeError("a frame was lost")

        yield trip


@contextmanager
def _hil(channel: str) -> Iterator[Trip]:
    with hub(channel), hil_bus(channel) as bus, _process(_echo, hil_bus, channel):
        yield _answered(bus)


@contextmanager
def _udp() -> Iterator[Trip]:
    with udp_bus() as bus, _process(_echo, udp_bus):
        yield _answered(bus)


@contextmanager
def _virtual() -> Iterator[Trip]:
    with can.Bus(interface="virtual", channel="bench", ignore_config=True) as bus:
        threading.Thread(target=_echo, args=(_virtual_bus,), daemon=True).start()
        yield _answered(bus)


@contextmanager
def _socket_pair() -> Iterator[Trip]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with near, far, _process(_echo_socket, far):

        def trip() -> None:
            near.send(DATA)
            near.recv(16)

        yield trip


def _virtual_bus() -> can.BusABC:
    return can.Bus(interface="virtual", channel="bench", ignore_config=True)


def _answered(bus: can.BusABC) -> Trip:
    """A trip by python-can's interface, when the echo has said that it is there."""
    _wait_for_answer(bus)

    def trip() -> None:
        bus.send(_message(THERE, DATA))
        _wait_for_answer(bus)

    return trip


def _wait_for_answer(bus: can.BusABC) -> None:
    while True:  # udp_multicast hears itself, too
        message = bus.recv(LIMIT_S)
        if message is None:
            raise RuntimeError(f"a frame was lost on {bus}")
        if message.arbitration_id == BACK:
            return


def _message(can_id: int, data: bytes | bytearray) -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data)


@contextmanager
def _process(target: Callable[..., None], *arguments: Any) -> Iterator[None]:
    process = multiprocessing.get_context("spawn").Process(target=target, args=arguments, daemon=True)
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _echo_raw(channel: str) -> None:
    with hil_bus(channel) as bus:
        bus.send_raw(BACK, b"")  # type: ignore[attr-defined]
        while (frame := bus.recv_raw(LIMIT_S)) is not None:  # type: ignore[attr-defined]
            bus.send_raw(BACK, frame.data)  # type: ignore[attr-defined]


def _echo(open_bus: Callable[..., can.BusABC], *arguments: Any) -> None:
    with open_bus(*arguments) as bus:
        bus.send(_message(BACK, b""))
        while (message := bus.recv(LIMIT_S)) is not None:
            if message.arbitration_id == THERE:
                bus.send(_message(BACK, message.data))


def _echo_socket(link: socket.socket) -> None:
    while data := link.recv(16):
        link.send(data)


def _hub_percent(period_s: float, duration_s: float = 2.0) -> float:
    """Two nodes send in turns, half a period apart, and read what has come."""
    channel = f"bench-{os.getpid()}-load"
    frames = [(0x180 + number, DATA) for number in range(FRAMES_A_CYCLE)]
    with hub(channel) as pid, hil_bus(channel) as one, hil_bus(channel) as other:
        begun_s, before_ns = time.monotonic(), processor_ns(pid)
        for number in range(int(2 * duration_s / period_s)):
            node: Any = other if number % 2 else one
            time.sleep(max(0.0, begun_s + number * period_s / 2 - time.monotonic()))
            node.drain_raw()
            node.send_raw_all(frames)
        return 100e-9 * (processor_ns(pid) - before_ns) / (time.monotonic() - begun_s)


if __name__ == "__main__":
    print(json.dumps(measure_here(udp=NO_UDP not in sys.argv)))
