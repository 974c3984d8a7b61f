"""`python -m controller`: the ATO unit as a process on the bus."""

from __future__ import annotations

import sys

from controller.unit import build
from hil.node.process import main

if __name__ == "__main__":
    sys.exit(main(unit_from=build))
