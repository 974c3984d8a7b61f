"""The bus contract: `ato_bench.dbc`, and the function that finds it.

The DBC is the one source of identifiers, bits, scaling, ranges, units, senders, cycle times, silence limits,
start values and E2E data. Nothing of this stands in the code.
"""

from __future__ import annotations

from pathlib import Path


def path() -> Path:
    """Where the shipped `ato_bench.dbc` is."""
    return Path(__file__).with_name("ato_bench.dbc")
