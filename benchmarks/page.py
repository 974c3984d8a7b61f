"""The measured tables in docs/performance.md: written by `make bench`, never by hand."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.rows import Row

HEADING = "### `"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def write(page: Path, measured: Mapping[str, Sequence[Row]], titles: Mapping[str, str]) -> None:
    """Put the tables between the page's two marks, in the order of `titles`; others that are there stay.

    Raises ValueError when the page does not have the marks.
    """
    text = page.read_text(encoding="utf-8")
    head, begin, rest = text.partition(BEGIN)
    before, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page}: needs the lines {BEGIN} and {END}; the tables go between them")
    sections = _sections(before) | {
        name: section(name, rows, titles[name]) for name, rows in measured.items()
    }
    shown = "\n\n".join(sections[name] for name in titles if name in sections)
    page.write_text(f"{head}{BEGIN}\n\n{shown}\n\n{END}{tail}", encoding="utf-8")


def section(name: str, rows: Sequence[Row], title: str) -> str:
    """The table of one benchmark, and what it was measured on."""
    host = f"{platform.system()} {platform.release()}, {os.cpu_count()} processors"
    lines = [
        f"{HEADING}{name}`: {title}",
        "",
        f"Measured on {datetime.now(UTC):%Y-%m-%d}: {host}, Python {platform.python_version()}.",
        "",
        "| what | ours | peer | ours / peer | unit | peer is |",
        "|:--|--:|--:|--:|:--|:--|",
    ]
    for row in rows:
        peer = "–" if row.peer is None else f"{row.peer:.3g}"
        ratio = row.ratio_text.replace("-", "–")
        lines.append(f"| {row.what} | {row.ours:.3g} | {peer} | {ratio} | {row.unit} | {row.peer_is} |")
    return "\n".join(lines)


def _sections(text: str) -> dict[str, str]:
    """The tables that are there, by benchmark."""
    parts = text.split(f"\n{HEADING}")[1:]
    return {part.partition("`")[0]: f"{HEADING}{part.strip()}" for part in parts}
