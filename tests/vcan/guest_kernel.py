"""Kernels with vcan that boot as an ordinary process: user-mode Linux, or QEMU by virtme-ng."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

GUEST = Path(__file__).parent / "guest"
PROJECT = GUEST.parents[2]
UML_MODULES = Path("/usr/lib/uml/modules")
MAX_MAP_COUNT = Path("/proc/sys/vm/max_map_count")
MAPPINGS = 262_144
"""A gigabyte of single pages. Linux' default is 65530; with it the recorder ended too early."""
MEMORY = {"uml": "2G", "qemu": "2G"}


class NoKernel(Exception):
    """No kernel of this kind can be booted here; the text says what is missing."""


@dataclass(frozen=True)
class Guest:
    """One boot: a kernel process, the folder it writes to, and what to do to end it at once."""

    process: subprocess.Popen[bytes]
    out: Path

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def kill(self) -> None:
        """End it with everything it started: its processes are processes of the host."""
        if self.running:
            self.process.terminate()  # the shell ends the group of user-mode Linux, then its own
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(5)
        if self.running:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def last_words(self) -> str:
        """The end of what the tests and the kernel printed."""
        texts = []
        for name in ("command.log", "insmod.log", "console.log"):
            path = self.out / name
            text = path.read_text(errors="replace")[-3000:] if path.exists() else ""
            texts.append(f"--- {name}\n{text}")
        return "\n".join(texts)


def vcan_is_up() -> bool:
    try:
        return bool(int(Path("/sys/class/net/vcan0/flags").read_text(), 16) & 1)
    except (OSError, ValueError):
        return False


def choose(wanted: str, reasons_against: Mapping[str, Callable[[], str]]) -> str:
    """The kernel to test on: the one wanted, or the first of `reasons_against` with an empty reason.

    Raises NoKernel with every reason, or for a name that is none.
    """
    if wanted and wanted not in reasons_against:
        raise NoKernel(f"HIL_VCAN_KERNEL={wanted}: must be one of {', '.join(reasons_against)}")
    reasons = {}
    for kind in [wanted] if wanted else reasons_against:
        reason = reasons_against[kind]()
        if not reason:
            return kind
        reasons[kind] = reason
    raise NoKernel("; ".join(f"{kind}: {reason}" for kind, reason in reasons.items()))


def against_native() -> str:
    return "" if vcan_is_up() else "no interface vcan0 that is up (ip link add dev vcan0 type vcan)"


def against_uml() -> str:
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return "user-mode Linux needs Linux on x86-64"
    programs = {"linux.uml": "user-mode-linux", "insmod": "kmod", "ip": "iproute2", "candump": "can-utils"}
    if has_amx():
        programs["gcc"] = "gcc"
    return _missing(programs)


def against_qemu() -> str:
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return "the emulated machine needs Linux on x86-64"
    programs = {
        "qemu-system-x86_64": "qemu-system-x86",
        "busybox": "busybox-static",
        "script": "bsdutils",
        "insmod": "kmod",
        "ip": "iproute2",
        "candump": "can-utils",
    }
    missing = _missing(programs)
    if missing:
        return missing
    if _program("vng") is None:
        return "needs virtme-ng (pip install virtme-ng==1.42)"
    if kernel_image() is None:
        return (
            "no kernel image with vcan in /boot (Debian: linux-image-amd64, not the cloud image);"
            " or name the folder in which one was unpacked: HIL_VCAN_KERNEL_IMAGE"
        )
    return ""


REASONS_AGAINST = {"native": against_native, "uml": against_uml, "qemu": against_qemu}
"""In the order of preference."""


def boot(
    kind: str,
    command: str,
    out: Path,
    *,
    cpu: int | None = None,
    echo: bool = False,
    nice: int = 0,
    fifo: int = 0,
) -> Guest:
    """Boot a kernel of this kind with vcan0 and run a shell command in it; returns at once.

    `out` and the project are all that the guest can write to. `cpu`: the one
    CPU of the host that user-mode Linux may use: a switch between its processes on two CPUs costs three times
    as much. `echo`: load vcan with echo=1. `nice`: below 0 where granted. `fifo`: SCHED_FIFO of this priority
    where granted; while it computes without a pause the host still takes 50 ms of each second from it.
    """
    out.mkdir(parents=True, exist_ok=True)
    script = out / "command.sh"
    script.write_text(command + "\n")
    settings = {"HIL_GUEST_KIND": kind, "HIL_GUEST_OUT": str(out), "HIL_GUEST_COMMAND": str(script)}
    settings["HIL_GUEST_PROJECT"] = str(PROJECT)
    if echo:
        settings["HIL_GUEST_VCAN_ECHO"] = "1"
    arguments, environment = (_uml if kind == "uml" else _qemu)(settings, out)

    # It ends with a test run that was killed; user-mode Linux and its processes are a group of their own.
    line = f"trap 'kill -KILL -$child; kill -KILL 0' TERM; {shlex.join(arguments)} & child=$!; wait $child"
    arguments = ["sh", "-c", line]
    if _program("setpriv") is not None:
        arguments = [str(_program("setpriv")), "--pdeathsig", "TERM", *arguments]
    arguments = ["nice", "-n", str(nice), *arguments]
    if fifo and may_be_fifo(fifo):
        arguments = ["chrt", "-f", str(fifo), *arguments]
    with (out / "console.log").open("wb") as console, on_cpu(cpu if kind == "uml" else None):
        process = subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=console,
            stderr=subprocess.STDOUT,
            env=environment,
            cwd=out,
            start_new_session=True,
        )
    return Guest(process, out)


def may_be_fifo(priority: int) -> bool:
    if _program("chrt") is None:
        return False
    return not subprocess.run(["chrt", "-f", str(priority), "true"], stderr=subprocess.DEVNULL).returncode


def allow_mappings() -> int | None:
    """Let a process of the host have more mappings: user-mode Linux takes one for every page of a guest's.

    Returns what was allowed before, for `MAX_MAP_COUNT`, or None: that was enough, or it cannot be changed.
    """
    with contextlib.suppress(OSError, ValueError):
        before = int(MAX_MAP_COUNT.read_text())
        if before < MAPPINGS:
            MAX_MAP_COUNT.write_text(str(MAPPINGS))
            return before
    return None


@contextlib.contextmanager
def on_cpu(cpu: int | None) -> Iterator[None]:
    """Be on this CPU while a child starts and inherits that."""
    cpus = os.sched_getaffinity(0)
    try:
        if cpu is not None:
            os.sched_setaffinity(0, {cpu})
        yield
    finally:
        os.sched_setaffinity(0, cpus)


def _uml(settings: dict[str, str], out: Path) -> tuple[list[str], dict[str, str]]:
    # Kernel arguments that the kernel does not know become the environment of init.
    settings["HIL_GUEST_MODULES"] = str(UML_MODULES)
    arguments = [str(_program("linux.uml")), f"mem={MEMORY['uml']}", "root=/dev/root", "rootfstype=hostfs"]
    arguments += ["rootflags=/", "ro", "quiet", f"init={GUEST / 'init.sh'}", "con=null", "con0=fd:0,fd:1"]
    arguments += [f"uml_dir={out}/", *(f"{key}={value}" for key, value in settings.items())]
    environment = dict(os.environ)
    if has_amx():
        environment["LD_PRELOAD"] = str(_shim(out))
    if os.access("/dev/shm", os.W_OK):
        environment["TMPDIR"] = "/dev/shm"  # the guest's memory is a file; not on a disk
    return arguments, environment


def _qemu(settings: dict[str, str], out: Path) -> tuple[list[str], dict[str, str]]:
    image = kernel_image()
    if image is None:
        raise NoKernel(against_qemu())
    kernel, modules = image
    settings["HIL_GUEST_MODULES"] = str(modules)
    inside = " ".join(f"{key}={shlex.quote(value)}" for key, value in settings.items())
    command = [str(_program("vng")), "--run", str(kernel), "--cpus", "2", "--memory", MEMORY["qemu"]]
    command += ["--user", "root", "--rwdir", str(out), "--rwdir", str(PROJECT)]
    command += ["--exec", f"{inside} sh {GUEST / 'init.sh'}"]
    if not has_kvm():
        command.insert(1, "--disable-kvm")
    # It wants a terminal whose input stays open.
    line = f"sleep 100000 | script -qec {shlex.quote(shlex.join(command))} /dev/null"
    path = f"{Path(sys.executable).parent}:{_search_path()}"  # virtme-run is looked for there
    return ["sh", "-c", line], {**os.environ, "PATH": path}


def kernel_image() -> tuple[Path, Path] | None:
    """A kernel and its modules, with vcan among them: of $HIL_VCAN_KERNEL_IMAGE, else of this system."""
    for root in filter(None, (os.environ.get("HIL_VCAN_KERNEL_IMAGE"), "/")):
        for kernel in sorted(Path(root, "boot").glob("vmlinuz-*"), reverse=True):
            modules = Path(root, "lib/modules", kernel.name.removeprefix("vmlinuz-"))
            if any(modules.rglob("vcan.ko*")):
                return kernel, modules
    return None


def has_amx() -> bool:
    return "amx_tile" in Path("/proc/cpuinfo").read_text()


def has_kvm() -> bool:
    return os.access("/dev/kvm", os.R_OK | os.W_OK) and any(
        flag in Path("/proc/cpuinfo").read_text().split() for flag in ("vmx", "svm")
    )


def _shim(out: Path) -> Path:
    library = out / "xstate_shim.so"
    source = GUEST / "xstate_shim.c"
    subprocess.run(
        [str(_program("gcc")), "-O2", "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"], check=True
    )
    return library


def _missing(programs: Mapping[str, str]) -> str:
    packages = sorted({package for name, package in programs.items() if _program(name) is None})
    return f"needs the Debian packages {', '.join(packages)}" if packages else ""


def _program(name: str) -> str | None:
    return shutil.which(name, path=f"{Path(sys.executable).parent}:{_search_path()}")


def _search_path() -> str:
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"
