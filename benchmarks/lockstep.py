"""How much faster than real time the default scenario runs in lockstep; real time is the peer."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from statistics import median

from benchmarks.rows import Row

RUNS = 3


def measure() -> list[Row]:
    ways = {
        "lockstep, separate processes": ["-i", "hil", "-c", f"bench-{os.getpid()}"],
        "lockstep, one process": ["-i", "virtual", "-c", "bench"],
    }
    rates: dict[str, list[float]] = {name: [] for name in ways}
    for number in range(RUNS):
        for name, bus in ways.items():
            with tempfile.TemporaryDirectory() as folder:
                command = [sys.executable, "-m", "hil", "run", "--lockstep", "--json", *bus]
                done = subprocess.run(
                    [*command, "--out", f"{folder}/{number}"], capture_output=True, check=True
                )
            rates[name].append(json.loads(done.stdout)["speedup"])
    return [Row(name, median(values), 1.0, "x", "real time") for name, values in rates.items()]
