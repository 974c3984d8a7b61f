"""What can go wrong with a study. One line for the user, with the exit code that `hil` ends with."""

from __future__ import annotations

__all__ = ["StudyError"]


class StudyError(ValueError):
    """There is no study of that name, or it was asked for something that makes no sense."""

    exit_code = 2
