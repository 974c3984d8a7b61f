"""`make bench`: run every benchmark, or those named; prints one table of ours, peer and ratio."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import sys

from rich.console import Console
from rich.table import Table

from benchmarks.rows import Row

NAMES = (
    "codec",
    "protection",
    "fuzzy",
    "laws",
    "profile",
    "wakeup",
    "control_step",
    "local_bus",
    "burst",
    "lockstep",
)


def main() -> int:
    parser = argparse.ArgumentParser(prog="benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which of: {', '.join(NAMES)}")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    options = parser.parse_args()
    unknown = sorted(set(options.names) - set(NAMES))
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(NAMES)}")
    rows: list[Row] = []
    for name in options.names or NAMES:
        print(f"measuring {name} …", file=sys.stderr, flush=True)
        rows += importlib.import_module(f"benchmarks.{name}").measure()
    if options.json:
        print(json.dumps([row._asdict() for row in rows], indent=2))
        return 0
    table = Table("what", "ours", "peer", "ours/peer", "unit", "peer is", box=None, pad_edge=False)
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for row in rows:
        peer = "-" if row.peer is None else f"{row.peer:.3g}"
        table.add_row(row.what, f"{row.ours:.3g}", peer, row.ratio_text, row.unit, row.peer_is)
    Console().print(f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} processors")
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
