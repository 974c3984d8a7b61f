"""`python -m controller`: the ATO unit as a process on the bus."""

from __future__ import annotations

import sys

from hil.canbus.lean import leave_out_log_files


def run() -> int:
    """Start the unit; its exit code."""
    leave_out_log_files()
    # Only now: these import python-can.
    from controller.unit import build
    from hil.node.process import main

    return main(unit_from=build)


if __name__ == "__main__":
    sys.exit(run())
