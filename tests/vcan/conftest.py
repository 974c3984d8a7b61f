"""Real SocketCAN: natively where the host has vcan0, else inside a user-mode Linux kernel."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GUEST = Path(__file__).parent / "guest"
BOOT_LIMIT_S = 600


def vcan_is_up() -> bool:
    try:
        return bool(int(Path("/sys/class/net/vcan0/flags").read_text(), 16) & 1)
    except (OSError, ValueError):
        return False


def pytest_collection_modifyitems(items):
    """Tests marked `needs_vcan` run where vcan0 is; elsewhere the guest test runs them."""
    native = vcan_is_up()
    mine = [item for item in items if Path(item.fspath).parent == Path(__file__).parent]
    leave = [item for item in mine if bool(item.get_closest_marker("needs_vcan")) != native]
    items[:] = [item for item in items if item not in leave]


@pytest.fixture
def in_guest(tmp_path):
    """Boot a kernel with vcan0 as an ordinary process and run a shell command in it."""

    def run(command: str) -> str:
        kernel = shutil.which("linux.uml")
        missing = [
            name for name in ("linux.uml", "insmod", "ip") if shutil.which(name, path=search_path()) is None
        ]
        if missing or sys.platform != "linux" or os.geteuid() != 0:
            pytest.skip(
                f"no vcan0 here, and no user-mode Linux to boot one ({', '.join(missing) or 'needs root'}):"
                " needs the Debian packages user-mode-linux, kmod, iproute2"
            )
        environment = {**os.environ, "LD_PRELOAD": shim(tmp_path)} if needs_shim() else dict(os.environ)
        script = tmp_path / "command.sh"
        script.write_text(f"cd {ROOT}\n{command}\n")
        # Kernel arguments that the kernel does not know become the environment of init.
        arguments = ["mem=1G", "root=/dev/root", "rootfstype=hostfs", "rootflags=/", "rw", "quiet"]
        arguments += [
            f"init={GUEST / 'init.sh'}",
            f"HIL_GUEST_COMMAND={script}",
            "con=null",
            "con0=fd:0,fd:1",
        ]
        process = subprocess.run(
            [str(kernel), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            timeout=BOOT_LIMIT_S,
            cwd=tmp_path,
        )
        return process.stdout.decode(errors="replace")

    return run


def search_path() -> str:
    return f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin"


def needs_shim() -> bool:
    return "amx_tile" in Path("/proc/cpuinfo").read_text()


def shim(folder: Path) -> str:
    library = folder / "xstate_shim.so"
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip(
            "this processor has AMX, so user-mode Linux needs a small shim: needs the Debian package gcc"
        )
    subprocess.run(
        [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(GUEST / "xstate_shim.c"), "-ldl"],
        check=True,
    )
    return str(library)
