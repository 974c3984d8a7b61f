"""How a node waits for its deadlines, in words: asleep, polling the clock, with a rehearsal before it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["waiting_words"]


def waiting_words(spin: Mapping[str, Any] | None, rehearsal: Mapping[str, Any] | None) -> str:
    """What a node's status says of its `spin` and its `rehearsal`, as the end of a sentence about it."""
    if not spin or spin.get("mode", "off") == "off":
        why = (spin or {}).get("why", "")
        return f"only sleeps ({why})" if why else "only sleeps"
    text = f"polls for the last {spin['margin_ns'] / 1e3:.0f} us before a deadline"
    if not rehearsal or not rehearsal.get("runs"):
        return text
    return f"{text}, rehearses {rehearsal['lead_ns'] / 1e3:.0f} us before that"
