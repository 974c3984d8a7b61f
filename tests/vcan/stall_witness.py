"""Looks at the clock every 2 ms and does nothing else, above every node: what it misses, the machine missed.

`python stall_witness.py FILE`: until SIGTERM; then FILE has, as JSON, every gap of more than 10 ms.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

PERIOD_S = 0.002
GAP_NS = 10_000_000
PRIORITY = 90


def watch(ended: list[bool]) -> dict[str, object]:
    """`stalls`: [CLOCK_MONOTONIC at its begin, length] in ns; `looks`; `fifo`: whether it was above all."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        fifo = True
    except OSError:
        fifo = False
    stalls, looks, before_ns = [], 0, time.monotonic_ns()
    while not ended:
        time.sleep(PERIOD_S)
        now_ns = time.monotonic_ns()
        if now_ns - before_ns > GAP_NS:
            stalls.append((before_ns, now_ns - before_ns))
        before_ns = now_ns
        looks += 1
    return {"fifo": fifo, "looks": looks, "stalls": stalls}


if __name__ == "__main__":
    told: list[bool] = []
    signal.signal(signal.SIGTERM, lambda *_: told.append(True))
    Path(sys.argv[1]).write_text(json.dumps(watch(told)))
