"""A replay as one JSON document."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hil.bench.replay.comparison import MessageResult, Sample, SignalResult
from hil.bench.replay.job import Replayed

__all__ = ["SCHEMA", "document"]

SCHEMA = 1
MOST_TIMES = 20
"""So many times of missing and additional frames are listed; all are counted."""


def document(replayed: Replayed) -> dict[str, Any]:
    """Everything that was compared. Values are in the DBC's unit, times in s since the start."""
    comparison, rules = replayed.comparison, replayed.rules
    first = comparison.first
    return {
        "schema": SCHEMA,
        "log": str(replayed.place.log),
        "scenario": None if replayed.scenario is None else replayed.scenario.name,
        "node": replayed.node,
        "mode": replayed.mode,
        "cycle_instants": replayed.instants,
        "verdict": "match" if comparison.matches else "deviates",
        "first_deviation": None
        if first is None
        else {"time_s": first.time_s, "name": first.name, "what": first.what},
        "cycles": replayed.cycles,
        "duration_s": replayed.duration_s,
        "wall_time_s": replayed.wall_s,
        "restbus_frames": replayed.restbus_frames,
        "left_out_frames": replayed.left_out,
        "live": None if replayed.live is None else asdict(replayed.live),
        "rules": {
            "ignore": list(rules.ignore),
            "tolerance": dict(rules.tolerance),
            "default_tolerance_steps": rules.steps,
        },
        "messages": [_message(message) for message in comparison.messages],
    }


def _message(message: MessageResult) -> dict[str, Any]:
    return {
        "name": message.name,
        "verdict": "ignored" if message.ignored else "deviates" if message.deviates else "match",
        "recorded": message.recorded,
        "replayed": message.replayed,
        "missing": len(message.missing_s),
        "missing_at_s": list(message.missing_s[:MOST_TIMES]),
        "additional": len(message.additional_s),
        "additional_at_s": list(message.additional_s[:MOST_TIMES]),
        "wrong_length": message.wrong_length,
        "signals": [_signal(signal) for signal in message.signals],
    }


def _signal(signal: SignalResult) -> dict[str, Any]:
    return {
        "name": signal.signal.name,
        "unit": signal.signal.unit,
        "verdict": signal.verdict,
        "frames": signal.frames,
        "tolerance": signal.tolerance,
        "deviating": signal.deviating,
        "worst": _sample(signal.worst),
        "first": _sample(signal.first),
    }


def _sample(sample: Sample | None) -> dict[str, float] | None:
    return None if sample is None else sample._asdict()
