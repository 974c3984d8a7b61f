"""What can go wrong with a recording. Each error is one line for the user and carries its exit code."""

from __future__ import annotations

__all__ = ["MissingPackage", "NotRecorded", "RecordError", "RecordingUnreadable", "ViewerUnavailable"]


class RecordError(ValueError):
    """The recorder was asked for something that makes no sense, or a name is not in the recording."""

    exit_code = 2


class NotRecorded(RecordError, KeyError):
    """A recording has no message, signal, process or probe of that name."""

    def __str__(self) -> str:
        return str(self.args[0])  # a KeyError alone would show the quotes of a key


class RecordingUnreadable(RecordError):
    """A recording is not there, or is none."""


class MissingPackage(RuntimeError):
    """An optional package is not installed."""

    exit_code = 3


class ViewerUnavailable(RuntimeError):
    """The Rerun viewer, or what it needs to draw, is missing."""

    exit_code = 3
