"""The page of the bus: every message and signal of dbc/ato_bench.dbc."""

from __future__ import annotations

import re
from typing import Any

import cantools.database
from pieces import cell, code, number, table

import dbc


def dbc_page() -> str:
    """Markdown of all messages, in the order of their identifiers."""
    database: Any = cantools.database.load_file(dbc.path(), strict=True)
    messages = sorted(database.messages, key=lambda message: message.frame_id)
    lines = ["# Bus messages", "", "Generated from `dbc/ato_bench.dbc`. " + cell(_about()), ""]
    lines += table(
        ["node", "what it is"], [[code(node.name), cell(node.comment or "")] for node in database.nodes]
    )
    lines += table(
        ["identifier", "message", "sender", "sent", "bytes", "E2E data ID", "silence limit"],
        [
            [
                f"`0x{message.frame_id:03X}`",
                f"[{message.name}](#{message.name})",
                ", ".join(message.senders),
                _sent(message),
                str(message.length),
                _hex(_attribute(message, "E2EDataID")),
                _limit(message),
            ]
            for message in messages
        ],
        "llllrll",
    )
    for message in messages:
        lines += _message(message)
    return "\n".join(lines)


def _about() -> str:
    found = re.search(r'^CM_ "([^"]*)";', dbc.path().read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found else ""


def _message(message: Any) -> list[str]:
    lines = [f"## {message.name} {{#{message.name}}}", ""]
    if message.comment:
        lines += [cell(message.comment), ""]
    facts = [f"identifier `0x{message.frame_id:03X}`", f"from {', '.join(message.senders)}", _sent(message)]
    if _attribute(message, "E2EDataID"):
        facts.append(f"E2E profile 1, data ID {_hex(_attribute(message, 'E2EDataID'))}")
    if _limit(message):
        facts.append(f"silent for more than {_limit(message)}: the receiver reacts")
    lines += ["; ".join(facts) + ".", ""]
    lines += table(
        ["signal", "bits", "type", "factor", "offset", "range", "unit", "meaning"],
        [_signal(signal) for signal in message.signals],
        "llllrlll",
    )
    for signal in message.signals:
        if signal.choices:
            words = ", ".join(f"{value} `{word}`" for value, word in sorted(signal.choices.items()))
            lines += [f"{signal.name}: {words}", ""]
    return lines


def _signal(signal: Any) -> list[str]:
    last = signal.start + signal.length - 1
    bits = str(signal.start) if signal.length == 1 else f"{signal.start}–{last}"
    low = number(float(signal.minimum)) if signal.minimum is not None else ""
    high = number(float(signal.maximum)) if signal.maximum is not None else ""
    return [
        code(signal.name),
        bits,
        "signed" if signal.is_signed else "unsigned",
        number(float(signal.scale)),
        number(float(signal.offset)),
        f"{low} … {high}",
        signal.unit or "",
        cell(signal.comment or ""),
    ]


SEND_TYPES = {"cyclic": "cyclic", "event": "on event", "sync": "in lockstep only"}


def _sent(message: Any) -> str:
    if message.cycle_time:
        return f"every {message.cycle_time} ms"
    kind = _attribute(message, "GenMsgSendType")
    names = message.dbc.attribute_definitions["GenMsgSendType"].choices if message.dbc else []
    return SEND_TYPES[names[kind] if isinstance(kind, int) else str(kind or "cyclic")]


def _limit(message: Any) -> str:
    limit = _attribute(message, "TimeoutMs")
    return f"{limit} ms" if limit else ""


def _attribute(message: Any, name: str) -> Any:
    found = message.dbc.attributes.get(name) if message.dbc else None
    return found.value if found is not None else None


def _hex(value: Any) -> str:
    return f"`0x{int(value):04X}`" if value else ""
