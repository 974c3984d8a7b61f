"""Pieces of Markdown that every generated page needs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def cell(text: object) -> str:
    """Text that can stand in a cell of a table."""
    return " ".join(str(text).split()).replace("|", "\\|")


def code(text: object) -> str:
    """Text as code, in a cell; empty text stays empty."""
    return f"`{cell(text)}`" if str(text) else ""


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], align: str = "") -> list[str]:
    """Lines of a table; `align` has one letter l or r for each column."""
    marks = ["---:" if letter == "r" else "---" for letter in align.ljust(len(heads), "l")]
    lines = ["| " + " | ".join(heads) + " |", "| " + " | ".join(marks) + " |"]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def number(value: object) -> str:
    """A number as short as it is exact enough for a reader; other values as Python shows them."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.10g}"
    return str(value)
