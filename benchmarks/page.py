"""The measured tables in docs/performance.md: written by `make bench`, never by hand."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from benchmarks.rows import Row

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def write(page: Path, measured: Mapping[str, Sequence[Row]], titles: Mapping[str, str]) -> None:
    """Put the tables between the page's two marks. Raises ValueError when it does not have them."""
    text = page.read_text(encoding="utf-8")
    head, begin, rest = text.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"{page}: needs the lines {BEGIN} and {END}; the tables go between them")
    page.write_text(f"{head}{BEGIN}\n\n{tables(measured, titles)}\n{END}{tail}", encoding="utf-8")


def tables(measured: Mapping[str, Sequence[Row]], titles: Mapping[str, str]) -> str:
    """One table for each benchmark, and what it was measured on."""
    host = f"{platform.system()} {platform.release()}, {os.cpu_count()} processors"
    parts = [f"Measured on {datetime.now(UTC):%Y-%m-%d}: {host}, Python {platform.python_version()}.\n"]
    for name, rows in measured.items():
        parts.append(f"### `{name}`: {titles[name]}\n")
        parts.append("| what | ours | peer | ours / peer | unit | peer is |\n|:--|--:|--:|--:|:--|:--|")
        for row in rows:
            peer = "–" if row.peer is None else f"{row.peer:.3g}"
            ratio = row.ratio_text.replace("-", "–")
            parts.append(f"| {row.what} | {row.ours:.3g} | {peer} | {ratio} | {row.unit} | {row.peer_is} |")
        parts.append("")
    return "\n".join(parts)
