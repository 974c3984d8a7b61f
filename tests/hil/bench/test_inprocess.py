"""Nodes as threads of one process: what they are told."""

from pathlib import Path

from hil.bench.inprocess import _node_options
from hil.bench.outcome import RunOptions
from hil.bench.scenario import load_scenario
from hil.canbus.options import BusOptions


def test_threads_halt_at_the_same_overloads_as_processes_do_and_never_poll(tmp_path):
    asked = ["timing.startup_grace_s=0.5", "timing.max_overloads=7", "timing.max_consecutive_overloads=3"]
    scenario = load_scenario("metro_1500m", asked, scratch=tmp_path)
    options = RunOptions(scenario, tmp_path, BusOptions("virtual", "threads"))
    told = _node_options(options, "controller", Path(tmp_path))
    assert (told.overload_grace_s, told.max_misses, told.max_consecutive_misses) == (0.5, 7, 3)
    assert told.spin_ns == 0
