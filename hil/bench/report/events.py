"""What happened in a run, as a list: new plans by the controller's account, the rest from the event log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.bench.report.source import RunSource

__all__ = ["MOST_EVENTS", "EventRow", "event_rows"]

MOST_EVENTS = 400
TOLD = ("Mode", "Supervision", "DoorsClosed", "DepartureAuthorised", "EmergencyBrake", "EmergencyStop")
TOLD_MESSAGES = ("ATP_Restriction", "ODO_Balise", "ATO_Emergency", "TCU_Emergency", "BCU_Emergency")
LEVELS = {"INFO": "info", "WARN": "warning", "ERROR": "error"}


@dataclass(frozen=True)
class EventRow:
    """One line: time since the start [s], level (info, warning, error), who, what.

    `minor`: start-up and the states of the drives, folded away in the report.
    """

    time_s: float
    level: str
    source: str
    text: str
    minor: bool


def event_rows(source: RunSource) -> list[EventRow]:
    """All events by time; empty without a recording."""
    run = source.recording
    if run is None:
        return []
    rows: list[EventRow] = []
    latest: dict[str, str] = {}
    for event in run.events():
        message = event.text.partition(":")[0]
        # A restriction is sent again and again; it is news once.
        again = message in TOLD_MESSAGES and latest.get(message) == event.text
        latest[message] = event.text
        level, minor = LEVELS.get(event.level, "info"), again or _minor(event.level, event.text)
        rows.append(EventRow(event.time_s, level, event.source, event.text, minor))
    return sorted([*rows, *_plans(source)], key=lambda row: row.time_s)


def _plans(source: RunSource) -> list[EventRow]:
    run = source.recording
    if run is None or "controller.plan_number" not in run:
        return []
    column = run["controller.plan_number"]
    changes = np.flatnonzero(np.diff(column.values)) + 1
    return [
        EventRow(
            float(column.sim_time_s[k]),
            "info",
            "ATO",
            f"re-planned: plan {column.values[k]:g} in force",
            False,
        )
        for k in changes
    ]


def _minor(level: str, text: str) -> bool:
    if level != "INFO":
        # Every node says good-bye at the end of a run.
        return "Heartbeat: NmtState STOPPED" in text
    message, _, what = text.partition(":")
    if "first heard" in text:
        return True
    if message == "ATO_Status" and " Mode " in f"{what} ":  # ATO_Command says it ten times as often
        return True
    return message not in TOLD_MESSAGES and not any(f" {name} " in what for name in TOLD)
