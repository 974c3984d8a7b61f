"""The page of the Python interface: what scripts may rely on, from the docstrings."""

from __future__ import annotations

import inspect
from typing import Any

import hil.bench.scenario
import hil.canbus.contract
import hil.railway
import hil.record

PUBLIC: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    (
        "Recordings",
        "See [Recordings](../recordings.md) for examples.",
        (hil.record.open_run,),
    ),
    (
        "The bus contract",
        "For a program that speaks the DBC; see [your own plant](../how-to/own-plant.md).",
        (hil.canbus.contract.Contract, hil.canbus.contract.MessageCodec),
    ),
    (
        "Lines, trains, journeys",
        "Pure data in SI units; they import nothing else of the bench.",
        (hil.railway.load_line, hil.railway.load_train, hil.railway.load_journey),
    ),
)


def python_page() -> str:
    """Markdown of the public functions and classes."""
    lines = ["# Python", "", "Generated from the docstrings. The package is typed (`py.typed`).", ""]
    for title, about, things in PUBLIC:
        lines += [f"## {title}", "", about, ""]
        for thing in things:
            lines += _described(thing)
    return "\n".join(lines)


def _described(thing: Any) -> list[str]:
    lines = [
        f"### {thing.__name__}",
        "",
        "```python",
        f"from {_public_module(thing)} import {thing.__name__}",
    ]
    if inspect.isfunction(thing):
        lines += ["", f"{thing.__name__}{inspect.signature(thing)}"]
    lines += ["```", "", inspect.cleandoc(thing.__doc__ or ""), ""]
    if inspect.isclass(thing):
        lines += _members(thing)
    else:
        returned = inspect.signature(thing, eval_str=True).return_annotation
        if inspect.isclass(returned) and returned.__module__.startswith("hil.record"):
            lines += [f"It returns a `{returned.__name__}`:", "", *_members(returned)]
    return lines


def _members(owner: type) -> list[str]:
    rows = []
    for name, member in vars(owner).items():
        if name.startswith("_") and name != "__getitem__":
            continue
        function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        if not inspect.isfunction(function):
            continue
        text = inspect.cleandoc(function.__doc__ or "").split("\n\n")[0]
        parameters = [str(p) for p in inspect.signature(function).parameters.values() if p.name != "self"]
        shown = name if isinstance(member, property) else f"{name}({', '.join(parameters)})"
        rows += [f"`{shown}`", f":   {' '.join(text.split())}", ""]
    return rows


def _public_module(thing: Any) -> str:
    for module in (hil.record, hil.railway, hil.canbus.contract):
        if getattr(module, thing.__name__, None) is thing:
            return str(module.__name__)
    return str(thing.__module__)
