"""The adapter of the ATO goes bus-off: silence stops the train, and a restart brings the node back.

controller - vcan1 - can-gw - vcan2 - plant_sim; the error frames appear on vcan1 only, as from its adapter.
"""

import itertools
import subprocess
import sys
import time

import can
import pytest
from test_kernel_faults import (  # noqa: F401 - fixtures
    COMMAND_LOST,
    CUT,
    FAST_MPS,
    PLANTS,
    SILENCE_LIMIT_S,
    assert_braked,
    bridge,
    candump,
    commands,
    nodes,
    states,
)
from vcan_support import wait_for_speed

from hil.bench.scenario import load_scenario
from hil.node.start_limit import start_limit_s

pytestmark = [pytest.mark.needs_vcan, pytest.mark.realtime, pytest.mark.timeout(300)]

BUS_OFF, RESTARTED = 0x40, 0x100


def report(classes, channel="vcan1"):
    with can.Bus(interface="socketcan", channel=channel) as adapter:
        adapter.send(can.Message(arbitration_id=classes, is_error_frame=True, data=bytes(8)))


def test_bus_off_of_the_controller_stops_the_train_and_a_restart_ends_the_silence(
    nodes, candump, record_property  # noqa: F811 - fixtures
):  # fmt: skip
    pair = nodes()
    wait_for_speed(FAST_MPS, PLANTS)
    report(BUS_OFF)
    time.sleep(1.5)
    report(RESTARTED)
    time.sleep(1.0)
    pair.stop()
    frames = candump.stop()
    sent = [frame.time_s for frame in commands(frames, "vcan1")]
    gaps = [(after - before, before, after) for before, after in itertools.pairwise(sent)]
    gap_s, last_s, again_s = max(gaps)
    # Nothing is sent while it is off, and nothing of before afterwards.
    assert 1.3 < gap_s < 3.0
    times, tcu = states(frames, "TCU_Status", "State")
    reaction_s = float(times[(tcu == CUT) & (times > last_s)][0]) - last_s
    assert SILENCE_LIMIT_S - 0.02 < reaction_s < SILENCE_LIMIT_S + 0.3
    times, bcu = states(frames, "BCU_Status", "State")
    assert COMMAND_LOST in bcu[(times > last_s) & (times < again_s)]
    assert_braked(frames, last_s, again_s)
    assert sent[-1] - again_s > 0.5
    record_property(
        "figure: bus-off",
        f"traction cut {reaction_s * 1e3:.0f} ms after the last command; sending again after {gap_s:.2f} s",
    )


def test_bus_off_that_lasts_ends_the_process_with_one_line(tmp_path):
    load_scenario("cat_linh_la_thanh", scratch=tmp_path).write(tmp_path / "scenario.toml")
    status = tmp_path / "plant_sim.json"
    command = [sys.executable, "-m", "plant_sim", "--scenario", str(tmp_path / "scenario.toml")]
    command += [
        "--status",
        str(status),
        "-i",
        "socketcan",
        "-c",
        "vcan0",
        "--bus-kwargs",
        "bus_off_limit=0.5",
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + start_limit_s()
        while not status.exists():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        report(BUS_OFF, "vcan0")
        _, stderr = process.communicate(timeout=30)
    finally:
        process.kill()
    lines = [line for line in stderr.splitlines() if "bus-off" in line]
    assert process.returncode == 3, stderr
    assert lines == stderr.splitlines()
    assert len(lines) == 1
    assert "plant_sim: socketcan channel 'vcan0': bus-off, and not restarted within 0.5 s" in lines[0]
    assert "restart-ms 100" in lines[0]
