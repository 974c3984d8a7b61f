"""Help that teaches by example, and what the shell completes: put on every command in one place.

A command's docstring says what it does; its paragraphs that begin with `[bold]hil …[/bold]` are examples,
each with what it is for behind it. Here they become one block that fits the terminal. Square brackets in the
help of an option are defaults (`[runs/…]`) or units, not markup.
"""

from __future__ import annotations

import ast
import inspect
import re
import shutil
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

import typer
from typer.models import ParameterInfo

from hil.cli import completion

__all__ = ["help_text", "summary_of", "teach"]

EXAMPLE = re.compile(r"\[bold\](hil .*?)\[/bold\]\s*(.*)", re.DOTALL)
NOT_MARKUP = re.compile(r"\[(?!/?(?:bold|dim|italic|red|green|yellow|cyan)\b)")
WIDEST = 100
MARGIN = 4  # what typer leaves free at the sides, and our indent

Complete = Callable[[str], completion.Words]

COMPLETED: dict[str, Complete] = {
    "law": completion.complete_laws,
    "laws": completion.complete_law_list,
    "line": completion.complete_lines,
    "node": completion.complete_nodes,
    "overrides": completion.complete_overrides,
    "run": completion.complete_runs,
    "runs": completion.complete_runs,
    "scenario": completion.complete_scenarios,
    "train": completion.complete_trains,
}
"""By name of the parameter, which is the same thing in every command."""


def teach(command: Callable[..., Any]) -> str:
    """Prepare a command's parameters; returns its help text."""
    hints = get_type_hints(command, include_extras=True)
    # Evaluated once and kept: annotations that are text would be made anew, without what is put on them here.
    command.__annotations__ = hints
    for name, hint in hints.items():
        for info in getattr(hint, "__metadata__", ()):
            if isinstance(info, ParameterInfo):
                info.help = _literal(info.help) if info.help else info.help
                if info.autocompletion is None and info.shell_complete is None and name in COMPLETED:
                    info.autocompletion = COMPLETED[name]
    return help_text(inspect.getdoc(command) or "")


def teach_group(group: typer.Typer) -> None:
    """Prepare all commands of a group."""
    for info in group.registered_commands:
        if info.callback is not None:
            info.help = teach(info.callback)


def help_text(docstring: str, width: int | None = None) -> str:
    """The docstring with its examples as one block, at most `width` characters wide (default: terminal)."""
    columns = min(shutil.get_terminal_size().columns, WIDEST) if width is None else width
    told: list[str] = []
    examples: list[tuple[str, str]] = []
    for paragraph in re.split(r"\n\s*\n", docstring.strip()):
        found = EXAMPLE.fullmatch(paragraph.strip())
        if found is None:
            told.append(" ".join(paragraph.split()))
        else:
            examples.append((found[1], " ".join(found[2].split())))
    if not examples:
        return "\n\n".join(told)
    return "\n\n".join([*told, "\b\n" + "\n".join(_block(examples, columns - MARGIN))])


def summary_of(module: Path, name: str) -> str:
    """What a command does, from its file: the first paragraph of its docstring, or the help of its group.

    Without importing it: a page of help need not wait for compilers and viewers.
    """
    for node in ast.parse(module.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == name:
            return " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call):
            targets = [target.id for target in node.targets if isinstance(target, ast.Name)]
            for keyword in node.value.keywords:
                if name in targets and keyword.arg == "help" and isinstance(keyword.value, ast.Constant):
                    return str(keyword.value.value)
    return ""


def _block(examples: list[tuple[str, str]], columns: int) -> list[str]:
    """Commands in bold with what they are for beside them, or below where that does not fit."""
    widest = max(len(command) for command, _ in examples)
    beside = all(widest + 2 + len(purpose) <= columns for _, purpose in examples)
    lines = ["[dim]Examples[/dim]"]
    for command, purpose in examples:
        shown = "\n".join(f"  [bold]{_literal(part)}[/bold]" for part in _continued(command, columns - 2))
        if not purpose:
            lines.append(shown)
        elif beside:
            lines.append(f"{shown}{' ' * (widest + 2 - len(command))}{_literal(purpose)}")
        else:
            lines += [shown, f"      {_literal(purpose)}"]
    return lines


def _continued(command: str, columns: int) -> list[str]:
    """A command over as many lines as it needs, as a shell takes it."""
    parts = textwrap.wrap(command, columns - 2, subsequent_indent="    ", break_on_hyphens=False)
    # Twice, or it would take the meaning from the bracket that follows.
    return [*(f"{part} \\\\" for part in parts[:-1]), *parts[-1:]]


def _literal(text: str) -> str:
    """Text whose square brackets are shown; those of a style stay markup. Doing it twice changes nothing."""
    return NOT_MARKUP.sub(r"\\[", text.replace(r"\[", "["))
