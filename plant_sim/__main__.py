"""The plant as a process: `python -m plant_sim --scenario FILE …`."""

from __future__ import annotations

import sys

from hil.canbus.lean import leave_out_log_files


def run() -> int:
    """Start the unit; its exit code."""
    leave_out_log_files()
    # Only now: these import python-can.
    from hil.node.process import main
    from plant_sim.unit import build

    return main(unit_from=build)


if __name__ == "__main__":
    sys.exit(run())
