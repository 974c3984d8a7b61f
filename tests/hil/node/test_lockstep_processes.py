"""Lockstep with real processes on the local bus: a pause changes nothing on the bus."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from hil.canbus.transport import BusOptions, Transport

TICKS = 120
STOPPED_AT = 60

# Each answers what it received from the other, so one frame lost, late or doubled changes all that follow.
SCRIPT = """
import sys
from hil.node import main

class Controller:
    name, nodes, receives, after = "controller", ("ATO",), ("ODO_Motion",), ()
    period_ns, probes = 10_000_000, ()
    def step(self, now_ns, inbox, outbox):
        odo = inbox["ODO_Motion"]
        demand = (odo.values["Position"] * 0.37 + odo.counter * 0.01) % 1.0
        outbox.put("ATO_Command", {"EffortDemand": demand})
    def probe(self): return ()
    def stop(self, outbox): pass
    def warm_up(self): pass

class Plant(Controller):
    name, nodes, receives, after = "plant", ("TCU", "ODO"), ("ATO_Command",), ("ATO_SyncDone",)
    position = 0.0
    def step(self, now_ns, inbox, outbox):
        command = inbox["ATO_Command"]
        self.position += command.values["EffortDemand"] + command.age_ns() * 1e-9
        outbox.put("ODO_Motion", {"Position": self.position})

unit = Controller if sys.argv.pop(1) == "controller" else Plant
sys.exit(main(unit_from=lambda scenario, contract: unit()))
"""


@pytest.fixture
def run(tmp_path, contract):
    """Runs both nodes for TICKS ticks; gives back every frame on the bus, in order."""
    script = tmp_path / "nodes.py"
    script.write_text(textwrap.dedent(SCRIPT))

    def play(name, pause=None):
        bus = BusOptions("hil", f"node-test-{os.getpid()}-{name}")
        sync, done = contract.message("SYNC"), contract.message("TCU_SyncDone")
        nodes = {}
        with contextlib.ExitStack() as stack:
            listener = stack.enter_context(Transport.open(bus, name="listener"))
            bench = stack.enter_context(Transport.open(bus, name="bench", receive=[done.can_id]))
            for role in ("controller", "plant"):
                status = tmp_path / f"{name}-{role}.json"
                nodes[role] = subprocess.Popen(
                    [sys.executable, str(script), role, "--scenario", str(script), "--clock", "lockstep",
                     "--status", str(status), *bus.to_arguments()],
                )  # fmt: skip
                stack.callback(nodes[role].wait)
                stack.callback(nodes[role].kill)
                end = time.monotonic() + 60
                while not status.exists():
                    assert time.monotonic() < end
                    time.sleep(0.02)
            for k in range(TICKS):
                if k == STOPPED_AT and pause is not None:
                    nodes[pause].send_signal(signal.SIGSTOP)
                bench.send(sync.can_id, sync.encode({"Tick": k}))
                if k == STOPPED_AT and pause is not None:
                    assert bench.receive(0.5) is None, "a tick was answered though a node stood still"
                    nodes[pause].send_signal(signal.SIGCONT)
                frame = bench.receive(30.0)
                assert frame is not None
                assert done.decode(frame.data)["Tick"] == k
            return [(frame.can_id, frame.data) for frame in listener.drain()]

    return play


def test_paused_process_leaves_the_bus_byte_for_byte_as_it_was(run):
    frames = run("free")
    assert run("controller-paused", pause="controller") == frames
    assert run("plant-paused", pause="plant") == frames
    assert len({data for can_id, data in frames if can_id == 0x181}) > TICKS / 2, "the nodes did not interact"
