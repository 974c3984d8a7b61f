"""Fixtures of the runs that a user would start."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from e2e_support import run_hil, start_hil  # noqa: F401
