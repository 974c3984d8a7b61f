"""What the benchmarks of the local bus have in common: a network of their own, priority, hub, peers."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import can

PRIORITY = 50
GROUP = "239.74.163.2"
NO_UDP = "--no-udp"

_NETWORK = "ip link set lo up && ip route add 224.0.0.0/4 dev lo"


def in_own_network(module: str) -> Any:
    """Run `python -m module` in a network namespace that has nothing but `lo`; its JSON document.

    Where that is not possible it runs with `--no-udp`, and this says so loudly. The local bus is the same in
    there: its sockets are in the file system.
    """
    command = [sys.executable, "-m", module]
    unshare = _unshare()
    if unshare:
        command = [*unshare, "sh", "-c", f'{_NETWORK} && exec "$@"', "sh", *command]
    else:
        command.append(NO_UDP)
        print(
            "NOT MEASURED: udp_multicast. It needs a network namespace of its own, so that no frame leaves "
            "this machine: 'unshare' (util-linux), 'ip' (iproute2), and root or user namespaces",
            file=sys.stderr,
        )
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
    return json.loads(done.stdout)


def _unshare() -> list[str]:
    if shutil.which("unshare") and shutil.which("ip"):
        for command in (["unshare", "-n"], ["unshare", "-r", "-n"]):
            if (
                subprocess.run([*command, "sh", "-c", _NETWORK], capture_output=True, check=False).returncode
                == 0
            ):
                return command
    return []


def ask_for_priority() -> bool:
    """SCHED_FIFO for this process, if it may; children inherit it."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        return True
    return False


@contextlib.contextmanager
def hub(channel: str) -> Iterator[int]:
    """A hub process with the scheduling of this one; its process id."""
    command = [sys.executable, "-m", "hil.canbus.local", "--channel", channel]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            if process.stdout is None or not process.stdout.readline().startswith("ready"):
                raise RuntimeError(f"no hub for channel {channel}")
            yield process.pid
        finally:
            process.terminate()


def hil_bus(channel: str, **options: Any) -> can.BusABC:
    """A bus of our own."""
    return can.Bus(interface="hil", channel=channel, ignore_config=True, autostart=False, **options)


def udp_bus(channel: str = GROUP) -> can.BusABC:
    """python-can's bus between processes; with hop limit 0 its frames stay in this machine."""
    return can.Bus(interface="udp_multicast", channel=channel, hop_limit=0, ignore_config=True)


def processor_ns(pid: int) -> int:
    """Processor time of a process so far."""
    with open(f"/proc/{pid}/schedstat", encoding="ascii") as file:
        return int(file.read().split()[0])
