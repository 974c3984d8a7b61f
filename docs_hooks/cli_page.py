"""The page of the command line: every command's help, from the parser that reads it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import typer
from pieces import cell, code, number, table

from hil.cli import _app

MARKUP = re.compile(r"\[/?(?:bold|italic|dim|cyan|green|yellow|red)\]")
EXAMPLE = re.compile(r"^(hil [^\n]*?)(?: {2,}(.*))?$")


def cli_page() -> str:
    """Markdown of all commands."""
    root = typer.main.get_command(_app([]))
    lines = [
        "# Command line",
        "",
        "Generated from the program. `hil COMMAND --help` shows the same in a terminal.",
        "",
        "Every command ends with an exit code: **0** passed, **1** ran but the verdict failed, **2**"
        " bad input, **3** something it needs is missing or died. Errors are one line on standard error."
        " With `--json` a command prints exactly one JSON document on standard output, nothing else.",
        "",
    ]
    commands = list(_commands(root, "hil"))
    lines += table(
        ["command", "does"],
        [
            [f"[`{name}`](#{name.replace(' ', '-')})", cell(_summary(command))]
            for name, command in commands
            if name != "hil"
        ],
    )
    for name, command in commands:
        if name != "hil":
            lines += _section(name, command)
    return "\n".join(lines)


def _commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    yield name, command
    for word, child in getattr(command, "commands", {}).items():
        yield from _commands(child, f"{name} {word}")


def _summary(command: Any) -> str:
    return MARKUP.sub("", (command.help or "").strip().split("\n\n")[0])


def _section(name: str, command: Any) -> list[str]:
    lines = [f"{'##' if name.count(' ') == 1 else '###'} {name} {{#{name.replace(' ', '-')}}}", ""]
    examples: list[str] = []
    for paragraph in MARKUP.sub("", (command.help or "").strip()).split("\n\n"):
        text = paragraph.strip().lstrip("\b\n")
        if all(EXAMPLE.match(line.strip()) for line in text.splitlines()):
            examples += [line.strip() for line in text.splitlines()]
        else:
            lines += [" ".join(text.split()), ""]
    if examples:
        lines += ["```text", *_aligned(examples), "```", ""]
    if getattr(command, "commands", None):
        return [*lines, "One of: " + ", ".join(code(f"{name} {word}") for word in command.commands), ""]
    rows = [_row(parameter) for parameter in command.params if not getattr(parameter, "hidden", False)]
    return lines + table(["option or argument", "value", "default", "meaning"], rows)


def _aligned(examples: list[str]) -> list[str]:
    pairs = [EXAMPLE.match(line) for line in examples]
    parts = [(match[1], match[2] or "") for match in pairs if match]
    width = max(len(command) for command, _ in parts)
    return [f"{command:{width}}  {meaning}".rstrip() for command, meaning in parts]


def _row(parameter: Any) -> list[str]:
    is_option = parameter.opts[0].startswith("-")
    name = ", ".join(parameter.opts + parameter.secondary_opts) if is_option else parameter.name.upper()
    value = "" if getattr(parameter, "is_flag", False) else (parameter.metavar or _kind(parameter))
    again = " (may be repeated)" if parameter.multiple or parameter.nargs == -1 else ""
    default = "required" if parameter.required else _default(parameter)
    return [code(name), code(value) + again, default, cell(MARKUP.sub("", parameter.help or ""))]


def _kind(parameter: Any) -> str:
    annotation = parameter.type_descriptor.annotation
    text = getattr(annotation, "__name__", None) or str(annotation)
    for wanted in ("Path", "float", "int", "str"):
        if wanted in str(annotation):
            return {"Path": "PATH", "float": "NUMBER", "int": "INTEGER", "str": "TEXT"}[wanted]
    return text.upper()


def _default(parameter: Any) -> str:
    default = parameter.default
    if default is None or default is False or default == () or callable(default):
        return ""
    return code(number(getattr(default, "value", default)))
