"""Real SocketCAN: natively where the host has vcan0, else in a guest kernel whose reports appear here.

A test marked `needs_vcan` runs where vcan0 is. On a host without one it is sent, by its node identifier, to a
kernel that boots as a process; what that pytest reports is read here and shown under the same name.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.bench.scenario import load_scenario

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from guest_kernel import (  # noqa: E402
    MAX_MAP_COUNT,
    REASONS_AGAINST,
    Guest,
    NoKernel,
    allow_mappings,
    boot,
    choose,
    has_kvm,
)

ROOT = HERE.parents[1]
GROUPS = {"test_real_time_run.py": "real_time", "test_kernel_faults.py": "faults"}
"""A group is one boot: the real-time run is alone, the faults need vcan's echo; others: function."""
LANES = (("real_time",), ("function", "faults"))
"""Boots at the same time, if there are CPUs for them, and one after the other."""
NO_REAL_TIME = "real time needs a kernel at native speed, and QEMU without KVM emulates"
GUEST_LIMIT_S = {"uml": 540, "qemu": 1500}
START_LIMIT_S = {"uml": 180, "qemu": 400}
"""Of a process of the bench: page faults and system calls are dear in a guest, and the host may be busy."""
NO_MEMORY_LOCK = ("setpriv", "--bounding-set", "-ipc_lock", "--inh-caps", "-ipc_lock")
"""In user-mode Linux a page is a mapping of the host, of which a process has 65530 (vm.max_map_count). A node
that locks its memory needs 54 thousand, one for every page that it could ever use; the host locks nothing."""
FIFO = {"real_time": 10}
"""Measured beside others' work: of 5000 wake-ups in a guest the latest was 3 ms late, 104 ms at nice -20."""
NICE = -20
ONE_AT_A_TIME = (
    "every worker of pytest-xdist would boot guest kernels of its own, at the same time; run it without -n:"
    " make test-vcan"
)


@pytest.hookimpl(trylast=True)  # after -k and -m have left out what they leave out
def pytest_collection_modifyitems(config, items):
    mine = [item for item in items if item.path.parent == HERE and item.get_closest_marker("needs_vcan")]
    if not mine:
        return
    try:
        kind = choose(os.environ.get("HIL_VCAN_KERNEL", ""), REASONS_AGAINST)
    except NoKernel as error:
        for item in mine:
            item.add_marker(pytest.mark.skip(reason=f"no kernel with vcan: {error}; see docs/vcan-in-ci.md"))
        return
    if kind == "native":
        return
    if hasattr(config, "workerinput"):
        for item in mine:
            item.add_marker(pytest.mark.skip(reason=ONE_AT_A_TIME))
        return
    if kind == "qemu" and not has_kvm():
        for item in mine:
            if group_of(item) == "real_time":
                item.add_marker(pytest.mark.skip(reason=NO_REAL_TIME))
        mine = [item for item in mine if group_of(item) != "real_time"]
    for item in mine:
        # The limits of tests hold in the guest; here the first test waits for a whole boot.
        item.add_marker(pytest.mark.timeout(0), append=False)
    config.stash[GUESTS] = Guests(kind, mine, config)


def group_of(item) -> str:
    return GROUPS.get(item.path.name, "function")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item, nextitem):
    """Show the guest's reports of this test in place of running it here."""
    guests = item.config.stash.get(GUESTS, None)
    if guests is None or item.nodeid not in guests.nodeids:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for report in guests.reports_of(item):
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_runtest_logreport(report):
    """In the guest: hand every report to the host, at once."""
    path = os.environ.get("HIL_GUEST_REPORTS")
    if path and CONFIG:
        data = CONFIG[0].hook.pytest_report_to_serializable(config=CONFIG[0], report=report)
        with Path(path).open("a", encoding="utf-8") as file:
            file.write(json.dumps(data, default=str) + "\n")


CONFIG: list[pytest.Config] = []


def pytest_configure(config):
    CONFIG[:] = [config]


def pytest_unconfigure(config):
    guests = config.stash.get(GUESTS, None)
    if guests is not None:
        guests.close()


def pytest_terminal_summary(terminalreporter, config):
    """The figures that tests recorded as properties `figure: …`, and where the guests' files are."""
    lines = [
        f"{name.removeprefix('figure: ')}: {value}"
        for key in ("passed", "failed")
        for report in terminalreporter.stats.get(key, [])
        for name, value in getattr(report, "user_properties", [])
        if name.startswith("figure: ")
    ]
    guests = config.stash.get(GUESTS, None)
    if guests is not None:
        lines += guests.account()
    if lines:
        terminalreporter.section("real SocketCAN (vcan)")
        for line in lines:
            terminalreporter.line(line)


class Guests:
    """The boots of one session: each begins when the first of its lane's tests is due."""

    def __init__(self, kind: str, items: list[pytest.Item], config: pytest.Config) -> None:
        self.kind = kind
        self.nodeids = {item.nodeid for item in items}
        self._config = config
        self._waiting = [
            [(group, ids) for group in lane if (ids := [i.nodeid for i in items if group_of(i) == group])]
            for lane in LANES
        ]
        if kind == "qemu" or len(os.sched_getaffinity(0)) < len(LANES):
            self._waiting = [[entry for lane in self._waiting for entry in lane]]
        self._running: list[tuple[str, Guest, float] | None] = [None] * len(self._waiting)
        self._ended: dict[str, Guest] = {}
        self._took: dict[str, float] = {}
        self._reports: dict[str, list[pytest.TestReport]] = {}
        self._read: dict[str, int] = {}
        self._mappings: int | None = None
        self.folder: Path | None = None

    def reports_of(self, item: pytest.Item) -> list[pytest.TestReport]:
        """What the guest says of this test; a failure with its last words if it says nothing."""
        group = group_of(item)
        while not self._complete(item.nodeid):
            self._step()
            if group in self._ended and not self._complete(item.nodeid):
                return [self._no_report(item, self._ended[group])]
            time.sleep(0.1)
        return self._reports[item.nodeid]

    def _complete(self, nodeid: str) -> bool:
        return any(report.when == "teardown" for report in self._reports.get(nodeid, []))

    def _step(self) -> None:
        if self.folder is None:
            factory = self._config._tmp_path_factory
            self.folder = factory.mktemp("vcan-guests")
            warm_numba_cache(self.folder)
            if self.kind == "uml":
                self._mappings = allow_mappings()
        for lane, waiting in enumerate(self._waiting):
            running = self._running[lane]
            if running is not None:
                group, guest, started = running
                ended = not guest.running
                self._read_reports(guest.out)
                took = time.monotonic() - started
                if not ended and took > GUEST_LIMIT_S[self.kind]:
                    guest.kill()
                    ended = True
                if not ended:
                    continue
                self._ended[group], self._took[group] = guest, took
                self._running[lane] = None
            if waiting:
                group, nodeids = waiting.pop(0)
                self._running[lane] = (group, self._boot(group, nodeids, lane), time.monotonic())

    def _boot(self, group: str, nodeids: list[str], lane: int) -> Guest:
        assert self.folder is not None
        out = self.folder / group
        exports = {"HIL_VCAN_KERNEL": "native", "HIL_GUEST_REPORTS": str(out / "reports.jsonl")}
        exports["HIL_GUEST_KIND"] = self.kind
        exports["HIL_START_TIMEOUT_S"] = str(START_LIMIT_S[self.kind])
        paths = [str(HERE / "guest" / "left_out"), os.environ.get("PYTHONPATH", "")]
        exports["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
        if "HIL_REQUIRE_ALL" in os.environ:
            exports["HIL_REQUIRE_ALL"] = os.environ["HIL_REQUIRE_ALL"]
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-q", f"--rootdir={ROOT}"]
        command += [f"--basetemp={out / 'tests'}", *nodeids]
        script = [f"cd {shlex.quote(str(ROOT))}"]
        script += [f"export {name}={shlex.quote(value)}" for name, value in exports.items()]
        if self.kind == "uml":
            script.append("ulimit -l 0")
            command = [*NO_MEMORY_LOCK, *command]
        script.append(shlex.join(command))
        cpus = sorted(os.sched_getaffinity(0))
        return boot(
            self.kind,
            "\n".join(script),
            out,
            cpu=cpus[-1 - lane % len(cpus)],
            echo=group == "faults",
            nice=NICE,
            fifo=FIFO.get(group, 0),
        )

    def _read_reports(self, out: Path) -> None:
        path = out / "reports.jsonl"
        if not path.exists():
            return
        lines = path.read_text(encoding="utf-8").split("\n")[:-1]
        for line in lines[self._read.get(str(path), 0) :]:
            report = self._config.hook.pytest_report_from_serializable(
                config=self._config, data=json.loads(line)
            )
            self._reports.setdefault(report.nodeid, []).append(report)
        self._read[str(path)] = len(lines)

    def _no_report(self, item: pytest.Item, guest: Guest) -> pytest.TestReport:
        text = f"the guest kernel ({self.kind}) did not report this test\n{guest.last_words()}"
        where = {"nodeid": item.nodeid, "location": item.location, "keywords": {}}
        return pytest.TestReport(**where, outcome="failed", longrepr=text, when="call")

    def account(self) -> list[str]:
        """One line a boot: how long it took, and its folder."""
        rows = [f"{self.kind} guest '{group}': {self._took[group]:.0f} s" for group in self._ended]
        rows += [
            f"guest '{group}': a process ran out of mappings and was ended; raise the host's vm.max_map_count"
            for group, guest in self._ended.items()
            if "max_map_count" in guest.last_words()
        ]
        return [*rows, f"files of the guests: {self.folder}"] if self.folder is not None else []

    def close(self) -> None:
        for running in self._running:
            if running is not None:
                running[1].kill()
        if self._mappings is not None:
            MAX_MAP_COUNT.write_text(str(self._mappings))


GUESTS = pytest.StashKey[Guests]()


WARM_UP = """
import sys
from importlib import import_module
from pathlib import Path
from hil.canbus.contract import Contract
from hil.node.cycle import warm_up
contract = Contract.load()
warm_up(import_module(f"{sys.argv[1]}.unit").build(Path(sys.argv[2]), contract), contract)
"""


def warm_numba_cache(folder: Path) -> None:
    """Compile here, at the host's speed, what the guests then find in numba's cache beside the source."""
    scenario = folder / "scenario.toml"
    load_scenario("cat_linh_la_thanh", scratch=folder).write(scenario)
    nodes = [
        subprocess.Popen([sys.executable, "-c", WARM_UP, name, str(scenario)], cwd=ROOT)
        for name in ("controller", "plant_sim")
    ]
    for node in nodes:
        if node.wait(240):
            raise RuntimeError(f"a node cannot be built here: {node.args}")
