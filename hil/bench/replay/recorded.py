"""A recorded log as replay needs it: the frames of one node, and those of everybody else, in their order."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from hil.canbus.contract import Contract
from hil.canbus.frame import EXTENDED_ID_FLAG, Frame
from hil.node.inbox import bus_identifier
from hil.node.outbox import STOPPED
from hil.record.log_formats import FRAME_FORMATS, read_log

__all__ = ["Place", "Recorded", "ReplayError", "find_log", "read_recorded"]

NS_PER_S = 1e9
FRAME_LOG, RECORDING, SCENARIO = "frames.blf", "run.rrd", "scenario.toml"


class ReplayError(ValueError):
    """The log cannot be replayed: which file, why, and what to do, in one line."""

    exit_code = 2


@dataclass(frozen=True)
class Place:
    """Where the log is, and what lies beside it: the scenario, the recording with the cycles."""

    log: Path
    scenario: Path | None
    recording: Path | None


@dataclass(frozen=True)
class Recorded:
    """Frames of a log in their order, split by who sent them.

    `own`: of the node, `others`: of everybody else. Both hold (place in the log, frame); the stamps are
    epoch ns. `ended` is the place at which the node said that it ends (heartbeat STOPPED), None if it
    did not: what comes after is not put to it. `left_out`: error and remote frames.
    """

    own: tuple[tuple[int, Frame], ...]
    others: tuple[tuple[int, Frame], ...]
    ended: int | None
    left_out: int
    lockstep: bool

    @property
    def start_ns(self) -> int:
        """Epoch time of the first frame, ns."""
        return min(frames[0][1].timestamp_ns for frames in (self.own, self.others) if frames)


def find_log(place: Path) -> Place:
    """The frame log of a run directory, or the file itself. Raises ReplayError."""
    if place.is_dir():
        if not (place / FRAME_LOG).is_file():
            raise ReplayError(f"{place}: no {FRAME_LOG} there (expected a run directory or a frame log)")
        log = place / FRAME_LOG
    elif place.suffix == ".rrd" and (place.parent / FRAME_LOG).is_file():
        log = place.parent / FRAME_LOG
    else:
        log = place
    if not log.is_file():
        raise ReplayError(f"{log}: no such log; give a run directory or a frame log")
    if log.suffix.lstrip(".") not in FRAME_FORMATS:
        kinds = ", ".join(f".{kind}" for kind in FRAME_FORMATS)
        raise ReplayError(f"{log}: not a frame log by its name; readable are {kinds}")
    folder = log.parent
    whole_run = (folder / SCENARIO).is_file()
    return Place(
        log=log,
        scenario=folder / SCENARIO if whole_run else None,
        # The cycles of a recording belong to the log that was written with it.
        recording=folder / RECORDING if log.name == FRAME_LOG and (folder / RECORDING).is_file() else None,
    )


def read_recorded(log: Path, contract: Contract, nodes: Iterable[str]) -> Recorded:
    """Read a log and split it between these nodes and the others.

    Raises RecordingUnreadable, and ReplayError when there is nothing to compare or nothing to replay.
    """
    nodes = tuple(nodes)
    ours = {bus_identifier(codec) for node in nodes for codec in contract.sent_by(node)}
    heartbeats = {
        bus_identifier(contract.message(f"{node}_Heartbeat"))
        for node in nodes
        if f"{node}_Heartbeat" in contract.messages
    }
    sync = bus_identifier(contract.message("SYNC")) if "SYNC" in contract.messages else None
    own: list[tuple[int, Frame]] = []
    others: list[tuple[int, Frame]] = []
    ended: int | None = None
    lockstep = False
    left_out = 0
    for place, message in enumerate(read_log(log)):
        if message.is_error_frame or message.is_remote_frame:
            left_out += 1
            continue
        can_id = message.arbitration_id | (EXTENDED_ID_FLAG if message.is_extended_id else 0)
        frame = Frame(round(message.timestamp * NS_PER_S), can_id, bytes(message.data))
        if can_id in ours:
            own.append((place, frame))
            if ended is None and can_id in heartbeats and frame.data[:1] == bytes([STOPPED]):
                ended = place
        else:
            others.append((place, frame))
            lockstep = lockstep or can_id == sync
    for frames, what, remedy in (
        (own, f"no frame of {', '.join(nodes)}", "there is nothing to compare"),
        (others, f"no frame of anybody but {', '.join(nodes)}", "there is nothing to replay"),
    ):
        if not frames:
            raise ReplayError(f"{log}: {what} by {contract.path.name}: {remedy}; another --dbc or --node?")
    return Recorded(tuple(own), tuple(others), ended, left_out, lockstep)
