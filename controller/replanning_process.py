"""Planning in a process of its own, so that the control loop never waits for it.

The loop writes a request of fixed size into a pipe that does not block, and looks at one number in shared
memory to see whether the answer is there. The answer is the columns of the new plan's table, in a slot of
that memory which the plan in use does not occupy; nothing is copied or allocated by their number. The
process ends when the pipe does, so it cannot outlive the controller, however that ends.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from controller.config import ControllerConfig
from controller.profile.reference import Columns, ReferenceTable
from controller.replanning import Answer, Replanner, Request, Solved, Start, past_s
from hil.node.start_limit import start_limit_s
from hil.node.timing import ring_directory
from hil.railway import Journey, SpeedLimit, load_journey

MOST_RESTRICTIONS = 8
SLOTS = 2
LONGER = 5
"""A new plan may have so many times the rows of the first one."""

REQUEST = struct.Struct(
    "=5q5d24d"
)  # number, start, base, slot, restrictions; the state; start, end, limit of each
SLOT_HEADER = struct.Struct("=3q3d")  # number, rows (0: no plan), ahead; step, start and last braking [s]
INDEX_BYTES = 64  # the number of the last answer, on a cache line of its own
FLOAT_BYTES = 8
COLUMNS = 4


class PlanningError(RuntimeError):
    """The planning process did not start."""

    exit_code = 3


class PlanMemory:
    """The shared memory: the number of the last answer, then the slots."""

    def __init__(self, path: Path, rows: int, *, create: bool) -> None:
        self.rows = rows
        column = rows * FLOAT_BYTES
        self._slot_bytes = SLOT_HEADER.size + SLOT_HEADER.size % FLOAT_BYTES + COLUMNS * column
        size = INDEX_BYTES + SLOTS * self._slot_bytes
        if create:
            path.write_bytes(bytes(size))  # every page is there before the first deadline
        with open(path, "r+b") as file:
            self._map = mmap.mmap(file.fileno(), size)
        self._index = memoryview(self._map)[:FLOAT_BYTES].cast("q")

    @property
    def answered(self) -> int:
        """Number of the last answer."""
        return int(self._index[0])

    def write(self, number: int, slot: int, solved: Solved) -> None:
        """Put an answer into a slot, then say that it is there."""
        columns, begin = solved.columns, INDEX_BYTES + slot * self._slot_bytes
        if columns is None or len(columns.preview_mps2) > self.rows:
            SLOT_HEADER.pack_into(self._map, begin, number, 0, 0, 0.0, 0.0, 0.0)
        else:
            SLOT_HEADER.pack_into(
                self._map, begin, number, len(columns.position_m), columns.ahead,
                columns.step_s, columns.start_s, columns.braking_from_s,
            )  # fmt: skip
            in_order = (
                columns.position_m,
                columns.speed_mps,
                columns.acceleration_mps2,
                columns.preview_mps2,
            )
            for k, values in enumerate(in_order):
                at = begin + SLOT_HEADER.size + k * self.rows * FLOAT_BYTES
                struct.pack_into(f"={len(values)}d", self._map, at, *values)
        self._index[0] = number

    def read(self, number: int, slot: int) -> ReferenceTable | None:
        """The table in a slot; None if there was no plan."""
        begin = INDEX_BYTES + slot * self._slot_bytes
        held, rows, ahead, step_s, start_s, braking_from_s = SLOT_HEADER.unpack_from(self._map, begin)
        if held != number or not rows:
            return None
        views = []
        for k, count in enumerate((rows, rows, rows, rows + ahead)):
            at = begin + SLOT_HEADER.size + k * self.rows * FLOAT_BYTES
            views.append(memoryview(self._map)[at : at + count * FLOAT_BYTES].cast("d"))
        return ReferenceTable.of_columns(Columns(step_s, ahead, start_s, braking_from_s, *views))

    def close(self) -> None:
        """Unmap, as far as no table is in use any more."""
        self._index.release()
        with contextlib.suppress(BufferError):
            self._map.close()


class ChildSource:
    """A plan source whose solver is a child process; see the module. `rows`: of the first plan's table."""

    def __init__(self, scenario: Path, rows: int) -> None:
        handle, name = tempfile.mkstemp(prefix="hil-plans-", dir=ring_directory())
        os.close(handle)
        self._path = Path(name)
        try:
            self._memory = PlanMemory(self._path, LONGER * rows, create=True)
            self._process = subprocess.Popen(
                [sys.executable, "-m", "controller.replanning_process",
                 str(scenario), name, str(LONGER * rows)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
            )  # fmt: skip
        except BaseException:
            self._path.unlink(missing_ok=True)
            raise
        self._slot_of: dict[int, int] = {}
        self._await_ready()
        stdin = self._process.stdin
        self._pipe = -1 if stdin is None else stdin.fileno()
        os.set_blocking(self._pipe, False)

    @property
    def pid(self) -> int:
        """Process id of the child."""
        return self._process.pid

    def post(self, request: Request) -> None:
        """Write the request into the pipe; if that is full, or its reader gone, there will be no answer."""
        slot = 1 if self._slot_of.get(request.base) == 0 else 0
        self._slot_of = {request.base: self._slot_of.get(request.base, -1), request.number: slot}
        with contextlib.suppress(OSError):
            os.write(self._pipe, packed(request, slot))

    def poll(self, number: int) -> Answer | None:
        """The answer, if it is there."""
        if self._memory.answered != number:
            return None
        table = self._memory.read(number, self._slot_of[number])
        return Answer(number, table, "" if table is not None else "no plan goes on from there")

    def work(self) -> None:
        """The child does it."""

    def close(self) -> None:
        """End the child and remove the memory."""
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._memory.close()
        self._path.unlink(missing_ok=True)

    def _await_ready(self) -> None:
        """Wait until the child has planned once, so that everything is compiled and in its caches."""
        stdout = self._process.stdout
        if stdout is None:
            return
        os.set_blocking(stdout.fileno(), False)
        limit_s = start_limit_s()
        deadline = time.monotonic() + limit_s
        said = b""
        while b"\n" not in said:
            said += stdout.read() or b""
            ended = self._process.poll() is not None
            if ended or time.monotonic() > deadline:
                what = "ended at once" if ended else f"was not ready after {limit_s:g} s"
                self.close()
                raise PlanningError(
                    f"the planning process {what}; controller.replanning.enabled = false drives without it"
                )
            time.sleep(0.005)


def packed(request: Request, slot: int) -> bytes:
    """A request as it goes through the pipe."""
    limits = [
        value for limit in request.restrictions for value in (limit.start_m, limit.end_m, limit.limit_mps)
    ]
    limits += [0.0] * (3 * MOST_RESTRICTIONS - len(limits))
    return REQUEST.pack(
        request.number, request.start, request.base, slot, len(request.restrictions),
        request.clock_s, request.position_m, request.speed_mps, request.acceleration_mps2,
        request.end_clock_s, *limits,
    )  # fmt: skip


def unpacked(data: bytes) -> tuple[Request, int]:
    """The request and its slot."""
    number, start, base, slot, count, *values = REQUEST.unpack(data)
    limits = values[5:]
    restrictions = tuple(SpeedLimit(*limits[3 * k : 3 * k + 3]) for k in range(count))
    clock_s, position_m, speed_mps, acceleration_mps2, end_clock_s = values[:5]
    request = Request(
        number,
        Start(start),
        base,
        clock_s,
        position_m,
        speed_mps,
        acceleration_mps2,
        end_clock_s,
        restrictions,
    )
    return request, slot


def main(arguments: list[str]) -> int:
    """`SCENARIO MEMORY ROWS`: answer requests from standard input until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who ends the controller closes the pipe
    scenario, memory, rows = Path(arguments[0]), Path(arguments[1]), int(arguments[2])
    journey, config = load_journey(scenario), ControllerConfig.load(scenario)
    replanner = Replanner(journey, config)
    plans = PlanMemory(memory, rows, create=False)
    _warm_up(journey, config)
    print("ready", flush=True)
    stdin = sys.stdin.buffer
    while len(data := stdin.read(REQUEST.size)) == REQUEST.size:
        request, slot = unpacked(data)
        plans.write(request.number, slot, replanner.solve(request))
    return 0


def _warm_up(journey: Journey, config: ControllerConfig) -> None:
    """Plan once from a stand and once under way."""
    replanner = Replanner(journey, config)
    middle_m = 0.5 * (journey.origin.position_m + journey.destination.position_m)
    begun_s = past_s(replanner.comfort)
    for start, speed_mps in ((Start.STANDING, 0.0), (Start.MOVING, 5.0)):
        replanner.solve(Request(1, start, 0, begun_s, middle_m, speed_mps, 0.0, journey.time_s))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
