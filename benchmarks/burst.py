"""A burst of four senders to one reader: what arrives in a second, and what is lost, beside udp_multicast."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
from collections import Counter
from contextlib import nullcontext
from typing import Any

import can

from benchmarks.peers import NO_UDP, hil_bus, hub, in_own_network, udp_bus
from benchmarks.rows import Row

SENDERS, FRAMES = 4, 25_000
FIRST_ID = 0x100
SILENCE_S = 1.0
ROUNDS = 2
UDP_GROUP = "239.74.163.3"


def measure() -> list[Row]:
    found = in_own_network("benchmarks.burst")
    ours = found["local bus"]
    peer = found.get("udp_multicast")
    is_ = "python-can udp_multicast" + ("" if peer else ": not measured")
    total = SENDERS * FRAMES
    what = f"burst of {SENDERS} senders, {total:,} frames by can.Message"
    return [
        Row(f"{what}: received", ours["per_s"], peer and peer["per_s"], "frames/s", is_),
        Row(f"{what}: lost", ours["lost"], peer and peer["lost"], "frames", is_),
        Row(f"{what}: out of order", ours["disordered"], peer and peer["disordered"], "frames", is_),
        Row(
            "the same, fast path: received",
            found["fast path"]["per_s"],
            peer and peer["per_s"],
            "frames/s",
            is_,
        ),
        Row("the same, fast path: lost", found["fast path"]["lost"], peer and peer["lost"], "frames", is_),
    ]


def measure_here(*, udp: bool) -> dict[str, dict[str, float]]:
    """Mean throughput of the rounds [frames/s], and all that was lost or out of order in them."""
    ways = ["local bus", "fast path", *(["udp_multicast"] if udp else [])]
    sums: dict[str, Counter[str]] = {way: Counter() for way in ways}
    for number in range(ROUNDS):
        for way in ways:
            sums[way] += _burst(way, f"burst-{os.getpid()}-{number}")
    return {
        way: {
            "per_s": found["received"] / (found["duration_ns"] / 1e9),
            "lost": found["lost"] / ROUNDS,
            "disordered": found["disordered"] / ROUNDS,
        }
        for way, found in sums.items()
    }


def _burst(way: str, channel: str) -> Counter[str]:
    context = multiprocessing.get_context("spawn")
    start = context.Event()
    ready = context.Semaphore(0)
    with nullcontext() if way == "udp_multicast" else hub(channel), _open(way, channel) as bus:
        senders = [
            context.Process(target=_send, args=(way, channel, FIRST_ID + k, ready, start), daemon=True)
            for k in range(SENDERS)
        ]
        for sender in senders:
            sender.start()
        for _ in senders:
            ready.acquire()
        start.set()
        found = _receive(bus, fast=way == "fast path")
        for sender in senders:
            sender.join(30.0)
            sender.kill()
    return found


def _open(way: str, channel: str, *, nothing: bool = False) -> can.BusABC:
    if way == "udp_multicast":
        return udp_bus(UDP_GROUP)
    return hil_bus(channel, can_filters=[{"can_id": 0x7FF, "can_mask": 0x7FF}] if nothing else None)


def _receive(bus: Any, *, fast: bool) -> Counter[str]:
    following: dict[int, int] = {}
    disordered = received = 0
    begun_ns = last_ns = 0
    while received < SENDERS * FRAMES:
        if fast:
            first = bus.recv_raw(SILENCE_S)
            frames = [] if first is None else [first, *bus.drain_raw()]
            taken = [(frame.can_id, frame.data) for frame in frames]
        else:
            message = bus.recv(SILENCE_S)
            taken = [] if message is None else [(message.arbitration_id, message.data)]
        if not taken:
            if begun_ns:
                break  # the rest is lost
            continue
        last_ns = time.monotonic_ns()
        begun_ns = begun_ns or last_ns
        received += len(taken)
        for can_id, data in taken:
            number = int.from_bytes(data, "little")
            disordered += number < following.get(can_id, 0)
            following[can_id] = number + 1
    lost = SENDERS * FRAMES - received
    return Counter(received=received, lost=lost, disordered=disordered, duration_ns=last_ns - begun_ns)


def _send(way: str, channel: str, can_id: int, ready: Any, start: Any) -> None:
    with _open(way, channel, nothing=True) as bus:
        ready.release()
        start.wait()
        for number in range(FRAMES):
            data = number.to_bytes(8, "little")
            if way == "fast path":
                bus.send_raw(can_id, data, None)  # type: ignore[attr-defined]
            else:
                bus.send(can.Message(arbitration_id=can_id, is_extended_id=False, data=data))


if __name__ == "__main__":
    print(json.dumps(measure_here(udp=NO_UDP not in sys.argv)))
