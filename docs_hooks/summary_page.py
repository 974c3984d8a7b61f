"""The page of summary.json, from its JSON schema; tests hold the schema against real runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pieces import cell, code, table

SCHEMA = Path(__file__).resolve().parent.parent / "docs" / "reference" / "summary.schema.json"


def summary_page() -> str:
    """Markdown of all keys of a summary."""
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    lines = [
        "# summary.json",
        "",
        schema["description"],
        "",
        "`hil run --json` prints it. Generated from the JSON schema"
        " [summary.schema.json](summary.schema.json), which you can validate against.",
        "",
    ]
    return "\n".join(lines + table(["key", "type", "meaning"], _rows(schema, "")))


def _rows(schema: Mapping[str, Any], path: str) -> Iterator[list[str]]:
    for key, part in schema.get("properties", {}).items():
        dotted = f"{path}.{key}" if path else key
        yield [code(dotted), _kind(part), cell(part.get("description", ""))]
        yield from _inside(part, dotted)


def _inside(part: Mapping[str, Any], dotted: str) -> Iterator[list[str]]:
    yield from _rows(part, dotted)
    entry = part.get("additionalProperties")
    if isinstance(entry, dict):
        yield from _rows(entry, f"{dotted}.*")
    if "items" in part:
        yield from _rows(part["items"], f"{dotted}[]")


def _kind(part: Mapping[str, Any]) -> str:
    if "enum" in part:
        return ", ".join(code(json.dumps(value)) for value in part["enum"])
    kinds = part.get("type", "object")
    return " or ".join(kinds) if isinstance(kinds, list) else str(kinds)
