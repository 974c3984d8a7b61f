"""What can be wrong with railway data."""

from __future__ import annotations


class RailwayDataError(ValueError):
    """A line, train or journey is wrong: file, key, value and limit in one line."""

    exit_code = 2
