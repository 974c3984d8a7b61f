"""Six seconds of a run in lockstep as a run directory leaves it: frames.blf and scenario.toml."""

from __future__ import annotations

import tempfile
from pathlib import Path

import can
import pytest

from hil.bench.bare import bare_run
from hil.bench.scenario import load_scenario
from hil.canbus.contract import Contract
from hil.record.log_formats import write_log

SCENARIO = "cat_linh_la_thanh"
TICK_NS = 10_000_000
TICKS = 600


class Enough(Exception):
    """The first block of frames is there."""


@pytest.fixture(scope="session")
def contract():
    return Contract.load()


@pytest.fixture(scope="session")
def frames(contract):
    """(tick, identifier, data) of the first seconds in lockstep, in the order of the bus."""
    heard = []

    def tap(block):
        heard.extend(block)
        raise Enough

    with pytest.raises(Enough):
        bare_run(SCENARIO, [], contract, tap=tap)
    sync = contract.message("SYNC")
    told, tick = [], 0
    for _, can_id, data in heard:
        if can_id == sync.can_id:
            tick = int(sync.decode(data)["Tick"])
            if tick == TICKS:
                break
        told.append((tick, can_id, data))
    return told


@pytest.fixture
def run_of(tmp_path):
    """Writes (stamp in ns, identifier, data) as a run directory."""
    with tempfile.TemporaryDirectory() as scratch:
        scenario = load_scenario(SCENARIO, scratch=Path(scratch))

    def make(stamped, kind="blf", name="run"):
        folder = tmp_path / name
        folder.mkdir()
        scenario.write(folder / "scenario.toml")
        messages = (
            can.Message(timestamp=1.7e9 + stamp / 1e9, arbitration_id=i, data=data, is_extended_id=False)
            for stamp, i, data in stamped
        )
        write_log(folder / f"frames.{kind}", kind, messages)
        return folder

    return make


@pytest.fixture
def lockstep_run(frames, run_of):
    """The run as it was."""
    return run_of([(tick * TICK_NS, can_id, data) for tick, can_id, data in frames])
