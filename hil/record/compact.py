"""Joins the small pieces of a finished recording: half the size, and it opens several times faster.

A recording is written in pieces of half a second, so that little is lost if the recorder dies. Nobody
needs them once it has ended.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from hil.record.viewer import viewer_binary

__all__ = ["LARGEST_BYTES", "compact", "repair"]

LARGEST_BYTES = 128 * 1024 * 1024
"""Longer recordings stay as they are: joining needs them in memory, and about 0.1 s for each MB."""


def compact(recording: Path, dashboard: Callable[[], rrb.Blueprint]) -> bool:
    """Replace a recording by its compact form under this dashboard; False if it is too large.

    The file is replaced in one step: whatever happens here, one of the two is there, and whole.
    """
    if recording.stat().st_size > LARGEST_BYTES:
        return False
    reader = RrdReader(recording)
    entry = reader.recordings()[0]
    chunks = reader.stream().collect()
    draft = recording.with_name(f"{recording.name}.{os.getpid()}.new")
    try:
        joined = rr.RecordingStream(
            entry.application_id, recording_id=entry.recording_id, send_properties=False
        )
        joined.set_sinks(rr.FileSink(draft, write_footer=True), default_blueprint=dashboard())
        joined.send_chunks(chunks)
        joined.disconnect()
        os.replace(draft, recording)
    finally:
        draft.unlink(missing_ok=True)
    return True


def repair(recording: Path, repaired: Path) -> bool:
    """Copy what is whole of a recording that was cut off; False if there is nothing."""
    command = [
        str(viewer_binary()),
        "rrd",
        "optimize",
        "--continue-on-error",
        str(recording),
        "-o",
        str(repaired),
    ]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    return done.returncode == 0 and repaired.is_file() and repaired.stat().st_size > 0
