"""Replay: a recorded log put to one node as restbus, and its answers compared with the recorded ones."""

from __future__ import annotations

from hil.bench.replay.comparison import Comparison, FirstDeviation, MessageResult, SignalResult
from hil.bench.replay.job import LiveFigures, Replayed, ReplayRequest, replay
from hil.bench.replay.live_job import LiveOptions, replay_live
from hil.bench.replay.recorded import ReplayError
from hil.bench.replay.rules import Rules, load_rules

__all__ = [
    "Comparison",
    "FirstDeviation",
    "LiveFigures",
    "LiveOptions",
    "MessageResult",
    "ReplayError",
    "ReplayRequest",
    "Replayed",
    "Rules",
    "SignalResult",
    "load_rules",
    "replay",
    "replay_live",
]
