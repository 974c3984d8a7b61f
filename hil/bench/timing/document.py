"""timing.json: a document that readers of cyclictest's JSON understand; the bench's own is under `hil`."""

from __future__ import annotations

import os
import platform
import shlex
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from hil import __version__
from hil.bench.timing.advice import Advice
from hil.bench.timing.campaign import Campaign
from hil.bench.timing.limits import Judged, verdict
from hil.bench.timing.misses import Miss
from hil.bench.timing.request import PEER
from hil.bench.timing.samples import Measured, Spread, histogram, ratio, spread

__all__ = ["as_document", "figures"]

MOST_MISSES = 200
QUANTITIES = (
    "wakeup_latency_us", "period_error_us", "execution_us", "signal_age_us", "command_latency_us",
    "plant_latency_us",
)  # fmt: skip


def as_document(
    campaign: Campaign,
    rows: Sequence[Judged],
    found: Sequence[Advice],
    *,
    started: datetime,
    ended: datetime,
    command: Sequence[str],
) -> dict[str, Any]:
    """The whole result.

    The top level is as cyclictest writes it, its keys `cmdline:` and `rt_test_version:` with their colons;
    each part under each condition is a thread of its own with two keys more, `name` and `condition`.
    """
    uname = platform.uname()
    judged = verdict(list(rows))
    threads = {
        str(number): _thread(known, campaign) for number, known in enumerate(campaign.measured.values())
    }
    return {
        "file_version": 1,
        "cmdline:": shlex.join(command),
        "rt_test_version:": campaign.peer.version if campaign.peer else "",
        "start_time": started.strftime("%a, %d %b %Y %H:%M:%S %z"),
        "end_time": ended.strftime("%a, %d %b %Y %H:%M:%S %z"),
        "return_code": 1 if judged == "failed" else 0,
        "sysinfo": {
            "sysname": uname.system,
            "nodename": uname.node,
            "release": uname.release,
            "version": uname.version,
            "machine": uname.machine,
            "realtime": int(campaign.host.preempt_rt),
        },
        "num_threads": len(threads),
        "resolution_in_ns": 0,
        "thread": threads,
        "hil": {
            "schema": 1,
            "version": __version__,
            "verdict": judged,
            "criteria": [row.as_dict() for row in rows],
            "settings": _settings(campaign),
            "conditions": {
                condition: {
                    "cpu_busy_share": round(campaign.busy_share.get(condition, 0.0), 4),
                    "cpu_steal_share": round(campaign.steal_share.get(condition, 0.0), 6),
                    "parts": {
                        part: figures(known, campaign.measured.get((condition, PEER)))
                        for (where, part), known in campaign.measured.items()
                        if where == condition
                    },
                }
                for condition in campaign.request.conditions
            },
            "host": campaign.host.as_dict() | {"realtime_competitors": sorted(campaign.competitors)},
            "advice": [vars(item) for item in found],
            "notes": list(campaign.notes),
        },
    }


def figures(known: Measured, peer: Measured | None) -> dict[str, Any]:
    """What one part under one condition gave: distributions in us, ratios to the peer, misses."""
    spreads = {name: spread(known.values(name)) for name in QUANTITIES}
    misses = known.misses()
    document: dict[str, Any] = {name: value.as_dict() for name, value in spreads.items() if value}
    absolute = spread(abs(known.values("period_error_us")))
    if absolute is not None:
        document["period_error_us"] = document["period_error_us"] | {"absolute": absolute.as_dict()}
    split = {name: spread(values) for name, values in known.spans_us().items()}
    if split:
        document["execution_split_us"] = {name: value.as_dict() for name, value in split.items() if value}
    theirs = spread(peer.wakeup_latency_us) if peer is not None and known.part != PEER else None
    document["ratio_to_cyclictest"] = _ratios(spreads["wakeup_latency_us"], theirs)
    document["cycles"] = len(known.wakeup_latency_us)
    document["cpu_share"] = {name: round(share, 4) for name, share in known.cpu_share().items()}
    document["sched_fifo"] = known.sched_fifo
    document["spin"] = known.slices[-1].rights.get("spin", {})
    document["rehearsal"] = known.slices[-1].rights.get("rehearsal", {})
    document["deadlines"] = {
        "missed": known.missed(),
        "witnessed": known.witnessed,
        "unseen": known.unseen,
        "misses": [_miss(miss) for miss in misses[:MOST_MISSES]],
        "not_listed": max(0, len(misses) - MOST_MISSES),
    }
    document["frames_lost"] = sum(piece.frames_lost for piece in known.slices)
    return document


def _ratios(ours: Spread | None, peer: Spread | None) -> dict[str, float | None]:
    values = {name: ratio(ours, peer, name) for name in ("p50", "p99", "p999", "max")}
    return {name: None if value is None else round(value, 4) for name, value in values.items()}


def _thread(known: Measured, campaign: Campaign) -> dict[str, Any]:
    values = known.wakeup_latency_us
    whole = spread(values)
    cpu = campaign.request.cpu
    if whole is None:
        return {"histogram": {}, "cycles": 0, "name": known.part, "condition": known.condition}
    return {
        "histogram": {str(us): count for us, count in histogram(values).items()},
        "cycles": whole.count,
        "min": int(whole.min),
        "max": int(whole.max),
        "avg": round(whole.mean, 2),
        "cpu": 0 if cpu is None else cpu,
        "node": 0,
        "name": known.part,
        "condition": known.condition,
    }


def _miss(miss: Miss) -> dict[str, Any]:
    return {
        "node": miss.node,
        "cycle": miss.cycle,
        "missed": miss.missed,
        "monotonic_s": round(miss.from_ns * 1e-9, 6),
        "lost_us": round(miss.lost_ns / 1e3, 1),
        "stall_us": None if miss.stall_ns is None else round(miss.stall_ns / 1e3, 1),
        "seen_by_witness": None if miss.stall_ns is None else miss.seen,
    }


def _settings(campaign: Campaign) -> dict[str, Any]:
    request = campaign.request
    return {
        "period_s": request.period_s,
        "duration_s": request.duration_s,
        "slices": request.slices,
        "parts": list(request.parts),
        "priority": request.priority,
        "sched_fifo": campaign.fifo,
        "cpu": request.cpu,
        "spin": request.spin,
        "load": campaign.load or None,
        "scenario": request.scenario.name,
        "bus": {"interface": request.bus.interface, "channel": request.bus.channel},
        "cpus": os.cpu_count(),
    }
