"""What can go wrong around a run, each with the exit code that `hil` ends with."""

from __future__ import annotations


class ScenarioError(ValueError):
    """A scenario, an override or an option is wrong: file, key, value and limit in one line."""

    exit_code = 2


class Aborted(RuntimeError):
    """The user asked to stop before there was a run to judge."""

    exit_code = 1


class BenchError(RuntimeError):
    """Something a run needs is missing or died: what, and the remedy, in one line."""

    exit_code = 3
