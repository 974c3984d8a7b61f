"""`hil doctor`: what this machine can do, and how to get the rest."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import shutil
import socket
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from hil.cli.doctor_vcan import Repair, ThisMachine, repair
from hil.node.realtime import DMA_LATENCY, IDLE_REMEDY
from hil.record.viewer import display_missing


@dataclass(frozen=True)
class Finding:
    """One ability of the machine. `state`: `yes`, `no`, or `partly`; `remedy` is empty for `yes`."""

    what: str
    state: str
    detail: str
    remedy: str = ""


def doctor(
    fix_vcan: Annotated[
        bool, typer.Option("--fix-vcan", help="Bring a virtual CAN interface up (root), or say how.")
    ] = False,
    channel: Annotated[str, typer.Option(help="The interface that --fix-vcan brings up.")] = "vcan0",
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")] = False,
) -> int:
    """Say what this machine can do for the bench, and how to get the rest.

    [bold]hil doctor[/bold]             what is there, what is missing, what to do

    [bold]hil doctor --fix-vcan[/bold]  as root brings vcan0 up, else says how
    """
    if fix_vcan:
        return _fix_vcan(channel, as_json=as_json)
    findings = [check() for check in CHECKS]
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
        return 0
    colour = {"yes": "green", "partly": "yellow", "no": "red"}
    table = Table("", "", "found", "to get it", box=None, pad_edge=False)
    for finding in findings:
        state = f"[{colour[finding.state]}]{finding.state}[/]"
        table.add_row(f"[bold]{finding.what}[/bold]", state, finding.detail, finding.remedy)
    Console().print(table)
    return 0


def _fix_vcan(channel: str, *, as_json: bool) -> int:
    """Exit code 0: it is up; 3: it is not, the last line says what to do."""
    done = repair(channel, ThisMachine())
    if as_json:
        typer.echo(json.dumps(done.as_json(), indent=2))
    else:
        _show_repair(done)
    return 0 if done.up else 3


def _show_repair(done: Repair) -> None:
    for step in done.steps:
        mark = {"done": "done   ", "failed": "failed ", "needed": "sudo "}[step.state]
        typer.echo(f"{mark}{step}{f'  ({step.detail})' if step.detail else ''}")
    if done.up:
        typer.echo(f"{done.channel} is up: hil run -i socketcan -c {done.channel}")
    else:
        typer.echo(f"hil doctor: {done.channel} is not up: {done.remedy}", err=True)


def local_bus() -> Finding:
    """The bench's own bus needs sockets only."""
    registered = any(e.name == "hil" for e in importlib.metadata.entry_points(group="can.interface"))
    kind = "AF_UNIX" if hasattr(socket, "AF_UNIX") else "127.0.0.1"
    if registered:
        return Finding("local bus", "yes", f"python-can interface 'hil' over {kind}")
    return Finding("local bus", "no", "python-can does not know the interface 'hil'", "pip install ato-hil")


def socketcan() -> Finding:
    """SocketCAN in the kernel, and a vcan0 that is up."""
    remedy = "sudo hil doctor --fix-vcan  (the local bus needs none of it)"
    if not hasattr(socket, "AF_CAN"):
        return Finding(
            "SocketCAN", "no", f"{platform.system()}: Python here has no AF_CAN", "a Linux machine"
        )
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return Finding("SocketCAN", "no", f"kernel without CAN ({error.strerror})", remedy)
    interfaces = [name for name in sorted(os.listdir("/sys/class/net")) if _is_can(name)]
    up = [name for name in interfaces if _is_up(name)]
    if up:
        return Finding("SocketCAN", "yes", f"up: {', '.join(up)}")
    return Finding(
        "SocketCAN", "partly", f"no CAN interface is up ({', '.join(interfaces) or 'none'})", remedy
    )


def scheduling() -> Finding:
    """SCHED_FIFO: the one lever that changes wake-up latency by an order of magnitude."""
    remedy = (
        "'@realtime - rtprio 99' and '@realtime - memlock unlimited' in /etc/security/limits.conf;"
        " in Docker --cap-add=sys_nice --ulimit rtprio=99 --ulimit memlock=-1"
    )
    if not hasattr(os, "sched_setscheduler"):
        return Finding("SCHED_FIFO", "no", f"not on {platform.system()}", "Linux")
    pid = os.fork()
    if pid == 0:  # a child tries, so that this process keeps its policy
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))
        except OSError:
            os._exit(1)
        os._exit(0)
    granted = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    if granted:
        return Finding("SCHED_FIFO", "yes", "priority 50 granted")
    return Finding("SCHED_FIFO", "no", "refused", remedy)


def memory_lock() -> Finding:
    """How much memory a process may lock."""
    if sys.platform == "win32":
        return Finding("memory lock", "no", "not on Windows", "Linux")
    import resource

    soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if soft == resource.RLIM_INFINITY or os.geteuid() == 0:
        return Finding("memory lock", "yes", "unlimited" if soft == resource.RLIM_INFINITY else "root")
    return Finding("memory lock", "partly", f"{soft >> 20} MiB", "memlock unlimited in limits.conf")


def idle_states() -> Finding:
    """Whether a process may keep the CPUs out of deep idle states while it runs."""
    if not DMA_LATENCY.exists():
        return Finding(
            "idle states", "no", f"no {DMA_LATENCY}", "Linux; a container: --device=/dev/cpu_dma_latency"
        )
    if os.access(DMA_LATENCY, os.W_OK):
        return Finding("idle states", "yes", "may be kept shallow")
    return Finding("idle states", "no", f"{DMA_LATENCY} is not writable", IDLE_REMEDY)


def kernel() -> Finding:
    """Kernel, preemption model and processors."""
    version = platform.release()
    realtime = Path("/sys/kernel/realtime")
    full = realtime.exists() and realtime.read_text().strip() == "1"
    detail = f"{platform.system()} {version}, {os.cpu_count()} processors"
    if full:
        return Finding("kernel", "yes", f"{detail}, PREEMPT_RT")
    return Finding(
        "kernel", "partly", f"{detail}, no PREEMPT_RT", "a kernel with PREEMPT_RT lowers the worst latency"
    )


def viewer() -> Finding:
    """The Rerun viewer and a display to open it on."""
    try:
        version = importlib.metadata.version("rerun-sdk")
    except importlib.metadata.PackageNotFoundError:
        return Finding("viewer", "no", "rerun-sdk is not installed", "pip install ato-hil")
    if display_missing():
        return Finding(
            "viewer",
            "partly",
            f"Rerun {version}, no display",
            "hil view --web RUN, or copy run.rrd to a desktop",
        )
    return Finding("viewer", "yes", f"Rerun {version}")


def vulkan() -> Finding:
    """A Vulkan driver, for the viewer and for rendering recordings without a display."""
    folders = [Path(p) / "vulkan/icd.d" for p in ("/usr/share", "/etc", "/usr/local/share")]
    drivers = [f.stem for folder in folders if folder.is_dir() for f in sorted(folder.glob("*.json"))]
    if drivers or not sys.platform.startswith("linux"):
        return Finding("Vulkan driver", "yes", f"{len(drivers)} found" if drivers else platform.system())
    return Finding("Vulkan driver", "no", "none found", "apt install mesa-vulkan-drivers (make system-deps)")


def tools() -> Finding:
    """Programs that engineers expect beside the bench."""
    wanted = {"candump": "can-utils", "cyclictest": "rt-tests"}
    missing = [package for program, package in wanted.items() if shutil.which(program) is None]
    there = [program for program in wanted if shutil.which(program)]
    state = "yes" if not missing else "partly" if there else "no"
    return Finding(
        "tools", state, ", ".join(there) or "none", f"apt install {' '.join(missing)}" if missing else ""
    )


CHECKS: tuple[Callable[[], Finding], ...] = (
    local_bus,
    socketcan,
    scheduling,
    memory_lock,
    idle_states,
    kernel,
    viewer,
    vulkan,
    tools,
)


def _is_can(name: str) -> bool:
    try:
        return Path(f"/sys/class/net/{name}/type").read_text().strip() == "280"  # ARPHRD_CAN
    except OSError:
        return False


def _is_up(name: str) -> bool:
    try:
        return bool(int(Path(f"/sys/class/net/{name}/flags").read_text(), 16) & 1)  # IFF_UP
    except (OSError, ValueError):
        return False
