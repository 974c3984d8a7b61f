"""Opening a recording's file, whole or as a recorder that was killed has left it."""

from __future__ import annotations

import warnings
from pathlib import Path

from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

__all__ = ["open_rrd"]


def open_rrd(file: Path) -> RrdReader:
    """A reader of the file's chunks. One without a footer, as it is while recording, needs no warning here:
    it is read from front to back.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="RRD file has no footer", category=RerunWarning)
        return RrdReader(file)
