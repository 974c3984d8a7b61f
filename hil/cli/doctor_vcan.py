"""`hil doctor --fix-vcan`: the commands that bring a virtual CAN interface up, done if the user may."""

from __future__ import annotations

import os
import platform
import re
import shlex
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from hil.canbus.options import has_socketcan, is_can_interface_up

__all__ = ["BadChannel", "Machine", "Repair", "Step", "ThisMachine", "repair"]

ARPHRD_CAN = 280  # linux/if_arp.h
LOCAL_BUS = "the local bus needs none of it: hil run -i hil"


class BadChannel(ValueError):
    """The name is not one that a vcan interface can be given."""

    exit_code = 2


@dataclass(frozen=True)
class Step:
    """One command. `state`: `needed` (not run, for want of root), `done` or `failed`, `detail` says why."""

    command: tuple[str, ...]
    state: str
    detail: str = ""

    def __str__(self) -> str:
        return shlex.join(self.command)


@dataclass(frozen=True)
class Repair:
    """What was found and done; `remedy` is empty when the interface is up."""

    channel: str
    up: bool
    steps: tuple[Step, ...] = field(default_factory=tuple)
    remedy: str = ""

    def as_json(self) -> dict[str, Any]:
        """The document of `--json`; a command is one line of a shell."""
        steps = [asdict(step) | {"command": str(step)} for step in self.steps]
        return asdict(self) | {"steps": steps}


class Machine(Protocol):
    """What the repair looks at, and with what it acts."""

    def is_root(self) -> bool:
        """Whether commands may be run."""

    def has_can(self) -> bool:
        """Whether the kernel has SocketCAN now."""

    def kind(self, channel: str) -> int | None:
        """Hardware type of an interface, None: there is none of that name."""

    def is_real(self, channel: str) -> bool:
        """Whether the interface belongs to a device."""

    def is_up(self, channel: str) -> bool:
        """Whether it is a CAN interface that is up."""

    def run(self, command: Sequence[str]) -> str:
        """Run a command; returns what it complained of in one line, empty when it did its work."""


def repair(channel: str, machine: Machine) -> Repair:
    """Bring the vcan interface `channel` up as root, or say what root would have to do. Raises BadChannel."""
    if not re.fullmatch(r"[A-Za-z][\w.-]{0,14}", channel):
        raise BadChannel(f"--channel {channel!r}: 1 to 15 letters, digits, '_', '-' or '.', a letter first")
    if machine.is_up(channel):
        return Repair(channel, up=True)
    kind = machine.kind(channel)
    if kind is not None and kind != ARPHRD_CAN:
        raise BadChannel(f"--channel {channel}: an interface of that name is there, and is no CAN interface")
    if machine.is_real(channel):
        remedy = f"a real adapter needs a bit rate: ip link set {channel} up type can bitrate 500000"
        return Repair(channel, up=False, remedy=remedy)
    commands: list[tuple[str, ...]] = [("modprobe", "-a", "can-raw", "can-bcm", "vcan")]
    if kind is None:
        commands.append(("ip", "link", "add", "dev", channel, "type", "vcan"))
    commands.append(("ip", "link", "set", "up", channel))
    if not machine.is_root():
        remedy = f"run it as root: sudo hil doctor --fix-vcan --channel {channel}; {LOCAL_BUS}"
        return Repair(channel, False, tuple(Step(command, "needed") for command in commands), remedy)
    steps: list[Step] = []
    for command in commands:
        complaint = machine.run(command)
        steps.append(Step(command, "failed" if complaint else "done", complaint))
        # Without modprobe, or with CAN built in, the rest may do all the same.
        if complaint and command[0] != "modprobe":
            break
    up = machine.is_up(channel)
    return Repair(channel, up, tuple(steps), "" if up else _remedy(machine))


def _remedy(machine: Machine) -> str:
    release = platform.release()
    ubuntu = f"Ubuntu: apt install linux-modules-extra-{release}"
    if machine.has_can():
        return (
            f"this kernel ({release}) has SocketCAN, but no vcan; {ubuntu}; container: modprobe vcan on"
            f" its host, and --cap-add=NET_ADMIN; {LOCAL_BUS}"
        )
    return (
        f"this kernel ({release}) has no SocketCAN; {ubuntu}; Debian: linux-image-amd64, not the cloud image;"
        " container: modprobe vcan on its host; else make test-vcan boots a kernel that has it as an ordinary"
        f" process; {LOCAL_BUS}"
    )


class ThisMachine:
    """The machine that we run on."""

    def __init__(self, run: Callable[..., subprocess.CompletedProcess[str]] = subprocess.run) -> None:
        self._run = run

    def is_root(self) -> bool:
        """Whether this is root."""
        return hasattr(os, "geteuid") and os.geteuid() == 0

    def has_can(self) -> bool:
        """Whether a CAN socket can be made."""
        return has_socketcan()

    def kind(self, channel: str) -> int | None:
        """Hardware type, as in linux/if_arp.h."""
        try:
            return int(Path(f"/sys/class/net/{channel}/type").read_text())
        except (OSError, ValueError):
            return None

    def is_real(self, channel: str) -> bool:
        """Whether it belongs to a device."""
        return Path(f"/sys/class/net/{channel}/device").exists()

    def is_up(self, channel: str) -> bool:
        """Whether it is a CAN interface that is up."""
        return is_can_interface_up(channel)

    def run(self, command: Sequence[str]) -> str:
        """Run a command; what it complained of."""
        path = f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
        try:
            done = self._run(
                ["env", f"PATH={path}", *command], capture_output=True, text=True, timeout=30, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            return " ".join(str(error).split())
        if done.returncode == 0:
            return ""
        complaint = " ".join((done.stderr or done.stdout or "").split())
        return complaint or f"exit code {done.returncode}"
