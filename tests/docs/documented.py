"""Commands of the documentation: where they stand, what they say, and what a marker asks of the test.

A command is a line of a fenced block (sh, console, bash), a line of an indented block that begins with a
program's name, or inline code that begins with `hil ` or `make `. A comment right before a block says how
it is tested:

    <!-- test: parse -->                        the command line is parsed, nothing is run
    <!-- test: rehearse -->                     `hil run` up to the start of its processes (default)
    <!-- test: run -->                          run as it stands
    <!-- test: run: --lockstep -i virtual -->   run with these words added to each `hil run`
    <!-- test: run: -i virtual; exit 1 -->      … and this exit code
    <!-- test: not run: why -->                 the `hil` commands in it are parsed
"""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

MARKER = re.compile(
    r"^\s*<!-- test: (?P<what>parse|rehearse|run|not run)(?:: (?P<words>.*?))?(?:; exit (?P<code>\d))? -->$"
)
FENCE = re.compile(r"^(?P<indent>\s*)```(?P<language>\w*)(?P<attributes>.*)$")
INLINE = re.compile(r"`((?:hil|make) [^`]+)`")
SHELLS = ("sh", "console", "bash")
PROGRAMS = [
    "hil", "make", "python", "pip", "sudo", "ip", "candump", "cansequence", "cangen", "can_viewer",
    "can_logger", "canplayer", "duckdb", "apt-get", "git", "sed", "pkill", "rerun",
    "HIL_VCAN_KERNEL=qemu", ".",
]  # fmt: skip
"""What a line of an indented block begins with if it is a command."""
DESCRIPTION = re.compile(r"\s{3,}(?=[^-\s\"'|&])(?!#).*$")
"""Words beside a command, set off by three spaces or more."""


@dataclass(frozen=True)
class Marker:
    """How a block is to be tested."""

    what: str = "default"
    words: str = ""
    code: int | None = None


@dataclass(frozen=True)
class Command:
    """One command line."""

    page: Path
    line: int
    text: str
    marker: Marker
    inline: bool = False

    @property
    def words(self) -> list[str]:
        return shlex.split(self.text, comments=True)

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}: {self.text}"


def commands(page: Path) -> list[Command]:
    """All commands of a page, in order."""
    found: list[Command] = []
    marker = Marker()
    fence = language = None
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fenced = FENCE.match(line)
        if fence is not None:
            if fenced and line.strip() == "```":
                fence, marker = None, Marker()
            elif language in SHELLS:
                found += _command(
                    page, number, line.strip().removeprefix("$ "), marker, language == "console", line
                )
            continue
        if fenced:
            fence, language = fenced["indent"], fenced["language"]
            continue
        told = MARKER.match(line)
        if told:
            code = int(told["code"]) if told["code"] else None
            marker = Marker(told["what"], told["words"] or "", code)
        elif line.startswith("    ") and line.split() and line.split()[0] in PROGRAMS:
            found += _command(page, number, line.strip(), marker, False, line)
        elif line.strip():
            marker = Marker()
            found += [
                Command(page, number, text, marker, inline=True)
                for text in INLINE.findall(line)
                if "*" not in text
            ]
    return found


def _command(page, number, text, marker, needs_prompt, line):
    if not text or text.startswith("#") or (needs_prompt and not line.strip().startswith("$ ")):
        return []
    return [Command(page, number, DESCRIPTION.sub("", text), marker)]


def files_of(page: Path) -> dict[str, str]:
    """Contents of the blocks with a title that is a file name."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r'^```(?:toml|python) title="([^"]+)"\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    return dict(blocks)


def changes_of(page: Path) -> list[tuple[str, str, str]]:
    """(file, before, after) of each diff block with a title."""
    text = page.read_text(encoding="utf-8")
    changes = []
    for name, body in re.findall(r'^```diff title="([^"]+)"\n(.*?)^```$', text, re.MULTILINE | re.DOTALL):
        lines = body.splitlines()
        before = "".join(line[1:] + "\n" for line in lines if line[:1] in "- " or not line)
        after = "".join(line[1:] + "\n" for line in lines if line[:1] in "+ " or not line)
        changes.append((name, before, after))
    return changes
