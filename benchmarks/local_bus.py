"""Round trip between two processes: the local bus beside a bare AF_UNIX socket pair, in turns."""

from __future__ import annotations

import multiprocessing
import os
import socket
import time
from statistics import median

import can

from benchmarks.rows import Row

ROUNDS, TRIPS = 5, 1000


def measure() -> list[Row]:
    context = multiprocessing.get_context("spawn")
    channel = f"bench-{os.getpid()}"
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours: list[float] = []
    peer: list[float] = []
    with can.Bus(interface="hil", channel=channel) as bus:
        echo_bus = context.Process(target=_echo_bus, args=(channel,), daemon=True)
        echo_bus.start()
        echo_socket = context.Process(target=_echo_socket, args=(far,), daemon=True)
        echo_socket.start()
        while bus.recv(0.1) is None:  # the echo says when it is there
            pass
        for _ in range(ROUNDS):
            for _ in range(TRIPS):
                start = time.perf_counter_ns()
                bus.send_raw(0x123, b"12345678")
                bus.recv_raw(5.0)
                ours.append((time.perf_counter_ns() - start) / 1000)
            for _ in range(TRIPS):
                start = time.perf_counter_ns()
                near.send(b"12345678")
                near.recv(16)
                peer.append((time.perf_counter_ns() - start) / 1000)
        near.close()
        echo_bus.terminate()
    return [
        Row(
            "round trip p50, two processes, through the hub",
            median(ours),
            median(peer),
            "us",
            "AF_UNIX socket pair, no hub",
        )
    ]


def _echo_bus(channel: str) -> None:
    with can.Bus(interface="hil", channel=channel) as bus:
        bus.send_raw(0x1, b"")
        while True:
            frame = bus.recv_raw(60.0)
            if frame is not None:
                bus.send_raw(0x124, frame.data)


def _echo_socket(link: socket.socket) -> None:
    while data := link.recv(16):
        link.send(data)
