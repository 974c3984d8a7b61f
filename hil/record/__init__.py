"""The recorder: every frame and every cycle on record, and reading it back.

`Recorder` writes `run.rrd` (Rerun) and `frames.blf` (any CAN tool); `open_run` reads a run;
`hil.record.render` draws its dashboard without a display. Names are imported when first used: the
libraries behind them are large, and a program that only lists scenarios need not load them.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.record.errors import (
        MissingPackage,
        NotRecorded,
        RecordError,
        RecordingUnreadable,
        ViewerUnavailable,
    )
    from hil.record.reader import Run, RunEvent
    from hil.record.recorder import Recorder, RecorderOptions, RecordingStats
    from hil.record.run_data import Column, RunData, SignalInfo, open_run

# Rerun warns of every file that is written without a footer, as ours is until it is whole (compact.py).
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding::rrd::file_sink=error")

__all__ = [
    "Column",
    "MissingPackage",
    "NotRecorded",
    "RecordError",
    "Recorder",
    "RecorderOptions",
    "RecordingStats",
    "RecordingUnreadable",
    "Run",
    "RunData",
    "RunEvent",
    "SignalInfo",
    "ViewerUnavailable",
    "open_run",
]

_HOME = {
    **dict.fromkeys(("MissingPackage", "NotRecorded", "RecordError"), "errors"),
    **dict.fromkeys(("RecordingUnreadable", "ViewerUnavailable"), "errors"),
    **dict.fromkeys(("Recorder", "RecorderOptions", "RecordingStats"), "recorder"),
    **dict.fromkeys(("Run", "RunEvent"), "reader"),
    **dict.fromkeys(("Column", "RunData", "SignalInfo", "open_run"), "run_data"),
}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"hil.record.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
