"""Wire time of a run: which bit rate its local bus has, and how loaded that bus was while the train drove."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from hil.bench.outcome import RunOptions
from hil.canbus.local import link
from hil.canbus.local.wire import WireError
from hil.canbus.options import LOCAL_INTERFACE
from hil.canbus.transport import BusOptions

COUNTERS = ("bitrate", "busy_ns", "time_ns", "frames_on_wire", "failed_frames")


def timed_bus(options: RunOptions) -> BusOptions:
    """The bus of a run. In lockstep a local bus has no bit rate: its time is not the wall clock's."""
    bus = options.bus
    if bus.interface != LOCAL_INTERFACE or not options.lockstep:
        return bus
    return replace(
        bus, bitrate=None, extra={key: value for key, value in bus.extra.items() if key != "data_bitrate"}
    )


def hub_arguments(bus: BusOptions, priority: int) -> list[str]:
    """What a child hub is started with so that this bus can be opened; SCHED_FIFO `priority` 0: none."""
    arguments = ["--channel", bus.channel, "--parent-pipe"]
    if bus.bitrate is not None:
        arguments += ["--bitrate", str(bus.bitrate)]
        if "data_bitrate" in bus.extra:
            arguments += ["--data-bitrate", str(bus.extra["data_bitrate"])]
    return [*arguments, "--priority", str(priority)] if priority else arguments


def wire_counters(bus: BusOptions) -> dict[str, Any]:
    """What the hub has counted on the wire by now; empty when there is no hub, or it has no bit rate."""
    if bus.interface != LOCAL_INTERFACE:
        return {}
    try:
        known = link.query(bus.channel)
    except (OSError, WireError):
        return {}
    return {key: known[key] for key in COUNTERS} if known.get("bitrate") else {}


def traffic_between(before: Mapping[str, Any], after: Mapping[str, Any]) -> dict[str, Any]:
    """Bit rate [bit/s], load (0..1, interframe space counts) and failed frames between two counts."""
    if not before or not after or after["time_ns"] <= before["time_ns"]:
        return {}
    busy_ns, time_ns = (after[key] - before[key] for key in ("busy_ns", "time_ns"))
    return {
        "bitrate": after["bitrate"],
        "load": round(busy_ns / time_ns, 6),
        "frames": after["frames_on_wire"] - before["frames_on_wire"],
        "failed_frames": after["failed_frames"] - before["failed_frames"],
    }
