"""`make bench`: run every benchmark, or those named; prints one table of ours, peer and ratio."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.page import write
from benchmarks.rows import Row

TITLES = {
    "wakeup": "wake-up latency of the loop, at SCHED_FIFO, in slices that alternate with cyclictest",
    "control_step": "the control step over the local bus, drain to send, and its split",
    "recorder": "what the recorder costs the control loop",
    "local_bus": "round trip of a frame between two processes",
    "burst": "100,000 frames from four senders",
    "codec": "encoding and decoding one frame",
    "protection": "E2E protection of one frame",
    "fuzzy": "one evaluation of a rule base",
    "laws": "one step of every control law",
    "profile": "energy-optimal speed profiles",
    "lockstep": "how much faster than real time lockstep runs",
}
"""The benchmarks and what each measures, in the order of the page."""

FILE_COLUMNS = 160
"""Width of the table where it goes into a file."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which of: {', '.join(TITLES)}")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.add_argument("--page", type=Path, metavar="FILE", help="also write the tables into this page")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(TITLES))
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(TITLES)}")
    measured: dict[str, list[Row]] = {}
    for name in options.names or TITLES:
        print(f"measuring {name} …", file=sys.stderr, flush=True)
        measured[name] = importlib.import_module(f"benchmarks.{name}").measure()
    if options.page:
        write(options.page, measured, TITLES)
    rows = [row for found in measured.values() for row in found]
    if options.json:
        print(json.dumps([row._asdict() for row in rows], indent=2))
        return 0
    table = Table("what", "ours", "peer", "ours/peer", "unit", "peer is", box=None, pad_edge=False)
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for row in rows:
        peer = "-" if row.peer is None else f"{row.peer:.3g}"
        table.add_row(row.what, f"{row.ours:.3g}", peer, row.ratio_text, row.unit, row.peer_is)
    console = Console(soft_wrap=True)
    if not console.is_terminal:
        console.width = FILE_COLUMNS
    console.print(f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} processors")
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
