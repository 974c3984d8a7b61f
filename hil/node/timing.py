"""The timing ring: one record a cycle, from the node to the recorder, through a memory-mapped file.

The writer never waits and makes no system call: it packs a record into the mapping and moves the write
index. A reader maps the same file, also after the writer has been killed; what it was too slow for is
counted as lost. Layout: a header (fixed fields, then JSON with the process name and the probes), then
`capacity` records of eight int64 and one float64 per probe, in the machine's byte order.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import struct
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hil.node.unit import Probe

__all__ = ["CYCLE_FIELDS", "RingError", "RingHeader", "TimingReader", "TimingRing", "ring_directory"]

# The int64 part of a record. Times are CLOCK_MONOTONIC ns, but scheduled_ns is simulated time in lockstep;
# missed: whole cycles skipped just before this one.
CYCLE_FIELDS = (
    "cycle", "scheduled_ns", "woke_ns", "read_ns", "stepped_ns", "encoded_ns", "sent_ns", "missed",
)  # fmt: skip
DEFAULT_CAPACITY = 65536

MAGIC = b"HILRING\n"
VERSION = 2
# magic, version, header bytes, capacity, record bytes, JSON bytes, pid, period_ns, realtime offset ns
FIXED = struct.Struct("=8sIIIIIIqq")
# On a cache line of its own and 8-byte aligned, so that it is read and written in one access.
INDEX_OFFSET = 64
JSON_OFFSET = 128
PAGE = 4096


class RingError(ValueError):
    """A file is no timing ring, or a ring cannot be made as asked."""

    exit_code = 3


@dataclass(frozen=True)
class RingHeader:
    """What the header of a ring says; times in ns."""

    name: str
    clock: str
    period_ns: int
    realtime_offset_ns: int
    capacity: int
    probes: tuple[tuple[str, str], ...]
    pid: int


class TimingRing:
    """Writer of a timing ring in a new file at `path` (an older one is replaced).

    `append` costs about a microsecond. `capacity` is a power of two.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        name: str,
        period_ns: int,
        probes: Sequence[Probe | tuple[str, str]] = (),
        clock: str = "realtime",
        realtime_offset_ns: int = 0,
        capacity: int = DEFAULT_CAPACITY,
    ) -> None:
        if capacity < 2 or capacity & (capacity - 1):
            raise RingError(f"timing ring {path}: capacity {capacity} must be a power of two, 2 or more")
        fields = [*CYCLE_FIELDS, *(probe[0] for probe in probes)]
        twice = sorted({field for field in fields if fields.count(field) > 1})
        if twice:
            raise RingError(f"timing ring {path}: probe name {', '.join(twice)} is taken; rename the probe")
        self.path = Path(path)
        self.capacity = capacity
        self.realtime_offset_ns = realtime_offset_ns
        self._name, self._clock, self._period_ns = name, clock, period_ns
        self._record = struct.Struct(f"={len(CYCLE_FIELDS)}q{len(probes)}d")
        about = json.dumps(
            {"name": name, "clock": clock, "probes": [list(probe) for probe in probes]}, ensure_ascii=True
        ).encode("ascii")
        self._about = about
        self._data_offset = -(-(JSON_OFFSET + len(about)) // PAGE) * PAGE
        self._map = _new_mapping(
            self.path, self._data_offset + capacity * self._record.size, self._write_header
        )
        self._index = memoryview(self._map)[INDEX_OFFSET : INDEX_OFFSET + 8].cast("Q")
        self._written = 0
        self._mask = capacity - 1
        self._size = self._record.size
        self._pack_into = self._record.pack_into

    def append(self, *record: float) -> None:
        """Write one record: the eight integers of CYCLE_FIELDS, then the probes in order."""
        written = self._written
        self._pack_into(self._map, self._data_offset + (written & self._mask) * self._size, *record)
        self._written = written = written + 1
        self._index[0] = written

    @property
    def written(self) -> int:
        """Records written since the ring was made."""
        return self._written

    def touch(self) -> None:
        """Bring the whole mapping into memory and the code into the caches before the first deadline."""
        scratch = bytearray(self._size)
        self._record.pack_into(scratch, 0, *self._record.unpack_from(scratch))
        if self._written == 0:
            empty = bytes(PAGE)
            for offset in range(self._data_offset, len(self._map) - PAGE, PAGE):
                self._map[offset : offset + PAGE] = empty

    def close(self) -> None:
        """Unmap; the file stays for its readers."""
        self._index.release()
        self._map.close()

    def __enter__(self) -> TimingRing:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _write_header(self, mapping: mmap.mmap) -> None:
        FIXED.pack_into(
            mapping, 0, MAGIC, VERSION, self._data_offset, self.capacity, self._record.size, len(self._about),
            os.getpid(), self._period_ns, self.realtime_offset_ns,
        )  # fmt: skip
        mapping[JSON_OFFSET : JSON_OFFSET + len(self._about)] = self._about


class TimingReader:
    """Reader of a timing ring; it never disturbs the writer and needs none to be alive."""

    def __init__(self, mapping: mmap.mmap, header: RingHeader, data_offset: int) -> None:
        self.header = header
        self.lost = 0
        names = [*CYCLE_FIELDS, *(name for name, _ in header.probes)]
        kinds = ["i8"] * len(CYCLE_FIELDS) + ["f8"] * len(header.probes)
        self.dtype = np.dtype(list(zip(names, kinds, strict=True)))
        self._map = mapping
        self._index = np.frombuffer(mapping, np.uint64, 1, INDEX_OFFSET)
        self._records = np.frombuffer(mapping, self.dtype, header.capacity, data_offset)
        self._read = 0

    @classmethod
    def open(cls, path: Path | str) -> TimingReader:
        """Map the ring at `path`. Raises RingError when there is none, or it is of another version."""
        try:
            with open(path, "rb") as file:
                mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise RingError(f"timing ring {path}: cannot be opened ({error}); is the node running?") from None
        if len(mapping) < PAGE or mapping[: len(MAGIC)] != MAGIC:
            raise RingError(f"timing ring {path}: this file is no timing ring")
        _, version, data_offset, capacity, record, about, pid, period_ns, offset_ns = FIXED.unpack_from(
            mapping
        )
        if version != VERSION:
            raise RingError(
                f"timing ring {path}: version {version}, but this program reads version {VERSION}"
            )
        text: dict[str, Any] = json.loads(mapping[JSON_OFFSET : JSON_OFFSET + about])
        probes = tuple((name, unit) for name, unit in text["probes"])
        if record != 8 * (len(CYCLE_FIELDS) + len(probes)) or len(mapping) < data_offset + capacity * record:
            raise RingError(f"timing ring {path}: the header does not fit the file; it is damaged")
        header = RingHeader(text["name"], text["clock"], period_ns, offset_ns, capacity, probes, pid)
        return cls(mapping, header, data_offset)

    @property
    def written(self) -> int:
        """Records the writer has written so far."""
        return int(self._index[0])

    def read_new(self) -> NDArray[np.void]:
        """All records since the last call, as a structured array (fields: CYCLE_FIELDS, then the probes)."""
        capacity = self.header.capacity
        end = self.written
        begin = max(self._read, end - capacity)
        first, last = begin % capacity, end % capacity
        if begin == end:
            records = np.empty(0, self.dtype)
        elif first < last:
            records = self._records[first:last].copy()
        else:
            records = np.concatenate((self._records[first:], self._records[:last]))
        # While we copied, the writer went on: the slot it works on now may hold half a record.
        safe = min(end, max(begin, self.written - capacity + 1))
        self.lost += safe - self._read
        self._read = end
        return records[safe - begin :]

    def close(self) -> None:
        """Unmap the file."""
        del self._index, self._records
        with contextlib.suppress(BufferError):  # a caller may still hold a view
            self._map.close()


def ring_directory() -> Path:
    """Where rings should live: shared memory when the system has it, else the temporary directory."""
    shared = Path("/dev/shm")
    if shared.is_dir() and os.access(shared, os.W_OK):
        return shared
    return Path(tempfile.gettempdir())


def _new_mapping(path: Path, size: int, write_header: Callable[[mmap.mmap], None]) -> mmap.mmap:
    """Make the file whole under another name first: who opens `path` finds a finished header."""
    draft = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        with open(draft, "w+b") as file:
            if hasattr(os, "posix_fallocate"):
                # Reserve it: writing to a hole of a full file system would be a SIGBUS in the loop.
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            mapping = mmap.mmap(file.fileno(), size)
        write_header(mapping)
        os.replace(draft, path)
    except OSError as error:
        draft.unlink(missing_ok=True)
        raise RingError(f"timing ring {path}: cannot be made ({error.strerror or error})") from None
    return mapping
