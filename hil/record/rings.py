"""The timing rings of the nodes: cycles as columns, and what was too fast to be read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.node import RingError, RingHeader, TimingReader

__all__ = ["TIMING_COLUMNS", "Cycles", "RingFeed"]

TIMING_COLUMNS: tuple[tuple[str, str], ...] = (
    ("wakeup_latency", "us"),
    ("read", "us"),
    ("step", "us"),
    ("encode", "us"),
    ("send", "us"),
    ("period_error", "us"),
    ("missed", "cycles"),
)
"""What is recorded of every cycle: name and unit. `missed` counts from the start of
the process."""

NS_PER_US = 1e3


@dataclass(frozen=True)
class Cycles:
    """Cycles of one process in order.

    `cycle` and `scheduled_ns` as in the ring, `timing` (n, TIMING_COLUMNS), `probes` (n, probes of the
    header). In lockstep there is no schedule to be late for: latency and period error are 0.
    """

    cycle: NDArray[np.int64]
    scheduled_ns: NDArray[np.int64]
    timing: NDArray[np.float64]
    probes: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.cycle)


class RingFeed:
    """Reads one ring file, which may appear only after the recorder has started."""

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        self.path = path
        self.records = 0
        self._reader: TimingReader | None = None
        self._woke_ns: int | None = None
        self._missed = 0

    @property
    def header(self) -> RingHeader:
        """What the node says about its ring. Raises RingError while the file is not there."""
        if self._reader is None:
            raise RingError(f"timing ring {self.path}: not there yet")
        return self._reader.header

    @property
    def lost(self) -> int:
        """Records overwritten before they were read."""
        return self._reader.lost if self._reader is not None else 0

    def read(self) -> Cycles | None:
        """All cycles since the last call; None while there are none."""
        if self._reader is None:
            self._open()
        if self._reader is None:
            return None
        records = self._reader.read_new()
        if not len(records):
            return None
        self.records += len(records)
        probes = [records[name] for name, _ in self.header.probes]
        return Cycles(
            cycle=records["cycle"].astype(np.int64),
            scheduled_ns=records["scheduled_ns"].astype(np.int64),
            timing=self._timing(records),
            probes=np.column_stack(probes) if probes else np.empty((len(records), 0)),
        )

    def close(self) -> None:
        """Let go of the file."""
        if self._reader is not None:
            self._reader.close()

    def _open(self) -> None:
        try:
            self._reader = TimingReader.open(self.path)
        except RingError:  # not there yet: the node is about to start
            if self.path.exists():
                raise
            return

    def _timing(self, records: NDArray[np.void]) -> NDArray[np.float64]:
        scheduled, woke = records["scheduled_ns"], records["woke_ns"]
        read, stepped = records["read_ns"], records["stepped_ns"]
        encoded, sent = records["encoded_ns"], records["sent_ns"]
        timing = np.zeros((len(records), len(TIMING_COLUMNS)))
        timing[:, 1] = (read - woke) / NS_PER_US
        timing[:, 2] = (stepped - read) / NS_PER_US
        timing[:, 3] = (encoded - stepped) / NS_PER_US
        timing[:, 4] = (sent - encoded) / NS_PER_US
        if self.header.clock == "realtime":
            timing[:, 0] = (woke - scheduled) / NS_PER_US
            before = woke[0] - self.header.period_ns if self._woke_ns is None else self._woke_ns
            timing[:, 5] = (np.diff(woke, prepend=before) - self.header.period_ns) / NS_PER_US
        missed = np.cumsum(records["missed"]) + self._missed
        timing[:, 6] = missed
        self._woke_ns, self._missed = int(woke[-1]), int(missed[-1])
        return timing
