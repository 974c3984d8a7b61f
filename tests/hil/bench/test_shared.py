import os
import subprocess
import sys

from hil.bench.shared import BusClaim, shared_folder
from hil.canbus.transport import BusOptions


def test_one_bench_at_a_time_drives_a_bus(channel):
    bus = BusOptions("hil", channel)
    first, second = BusClaim(), BusClaim()
    assert first.take(bus)
    assert not second.take(bus)
    assert second.take(BusOptions("hil", channel + "b"))
    first.release()
    assert second.take(bus)
    second.release()


def test_a_claim_dies_with_its_process(channel):
    source = (
        "import sys; from hil.bench.shared import BusClaim; from hil.canbus.transport import BusOptions;"
        f"claim = BusClaim(); print(claim.take(BusOptions('hil', '{channel}')), flush=True); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-c", source], stdin=-1, stdout=-1, text=True) as holder:
        assert holder.stdout.readline().strip() == "True"
        claim = BusClaim()
        assert not claim.take(BusOptions("hil", channel))
        holder.kill()
        holder.wait()
        assert claim.take(BusOptions("hil", channel))
        claim.release()


def test_the_folder_is_gone_after_the_run_and_those_of_killed_runs_are_swept():
    with subprocess.Popen([sys.executable, "-c", "pass"]) as dead:
        dead.wait()
    with shared_folder() as folder:
        left = folder.parent / f"hil-run-{dead.pid}-left"
        left.mkdir()
        assert str(os.getpid()) in folder.name
    assert not folder.exists()
    with shared_folder():
        assert not left.exists()
