"""The plant as a process: `python -m plant_sim --scenario FILE …`."""

from __future__ import annotations

import sys

from hil.node.process import main
from plant_sim.unit import build

if __name__ == "__main__":
    sys.exit(main(unit_from=build))
