"""Every command in README and docs: run, rehearsed or at least parsed by the parser that will read it."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest
import typer
from documented import PAGES, ROOT, Command, commands, files_of

import hil.bench.run
from hil.cli import _app, main
from hil.node.options import parse as parse_node
from hil.record.process import _parser as recorder_parser

QUICK = {
    ("list",), ("query",), ("export",), ("report",), ("study",),
    ("bus", "analyse"), ("bus", "load"), ("bus", "dump"),
}  # fmt: skip
"""Run as they stand, where they read a file and no bus."""

NOT_RUN = {
    "sudo": "changes the machine",
    "ip": "needs a CAN interface",
    "candump": "needs a CAN interface",
    "cansequence": "needs a CAN interface",
    "cangen": "needs a CAN interface",
    "can_viewer": "python-can's; shows until it is ended",
    "can_logger": "python-can's; logs until it is ended",
    "duckdb": "another project's",
    "dpkg-deb": "unpacks what apt-get has downloaded",
    "apt-get": "changes the machine",
    "pip": "changes the environment",
    "pkill": "the tutorial's way to kill a controller; the test of it is in tests/e2e",
    "HIL_VCAN_KERNEL=qemu": "boots a kernel",
    ".": "activates the environment",
}
"""Programs that are not the bench's, and why a test does not start them."""

RUN_NAMES = re.compile(r"^(RUN|runs/.*|.*…)$")
PLACEHOLDER = re.compile(r"^[\[{]|[\]}…]$|^…$|^\|$")
FILES = {name: text for page in PAGES for name, text in files_of(page).items()}


def by_page() -> list:
    return [
        pytest.param(found, id=str(page.relative_to(ROOT)))
        for page in PAGES
        if (found := [command for command in commands(page) if not command.inline])
    ]


@pytest.fixture
def folder(tmp_path, recorded, monkeypatch):
    """A working directory with the files that pages show and a run under every name that they use."""
    for name, text in FILES.items():
        if "/" not in name:
            (tmp_path / name).write_text(text, encoding="utf-8")
    import dbc

    shutil.copyfile(dbc.path(), tmp_path / "my.dbc")
    shutil.copytree(recorded, tmp_path / "RUN")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("found", by_page())
def test_every_command_of_a_page_works(found, folder, monkeypatch):
    for command in found:
        for part in _parts(command):
            _check(command, part, folder, monkeypatch)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_inline_commands_name_only_what_the_parser_knows(page):
    for command in commands(page):
        if command.inline:
            words = command.words
            if words[0] == "make":
                _check_make(command, words)
            else:
                _parse(command, words[1:], all_arguments=False)


def test_the_collector_finds_commands_in_fences_indented_blocks_and_text():
    texts = [" ".join(command.words) for page in PAGES for command in commands(page)]
    for wanted in (
        "hil run my.toml",
        "make test",
        "hil bus up -c bench -b 500000",
        "hil doctor",
    ):
        assert any(text.endswith(wanted) for text in texts), wanted
    assert len(texts) > 100


def test_a_command_with_an_option_that_does_not_exist_is_found(tmp_path):
    wrong = Command(ROOT / "README.md", 1, "hil run --no-such-option", commands(ROOT / "README.md")[0].marker)
    with pytest.raises(pytest.fail.Exception, match="no-such-option"):
        _parse(wrong, wrong.words[1:], all_arguments=True)


def _parts(command: Command) -> list[list[str]]:
    """The programs of a line, without those that only take what the first one writes."""
    parts: list[list[str]] = [[]]
    for word in command.words:
        if word in ("&&", ";", "|"):
            parts.append([])
        elif word.endswith(";"):
            parts[-1].append(word[:-1])
            parts.append([])
        else:
            parts[-1].append(word)
    return [part for part in parts if part]


def _check(command: Command, words: list[str], folder: Path, monkeypatch) -> None:
    program, arguments = words[0], words[1:]
    if program == "hil":
        _check_hil(command, arguments, folder, monkeypatch)
    elif program == "make":
        _check_make(command, words)
    elif program == "python":
        _check_python(command, arguments)
    elif command.marker.what == "run":
        script = command.text.replace("python -c", f"{sys.executable} -c")
        subprocess.run(["bash", "-c", script], cwd=folder, check=True, timeout=60)
    elif program not in NOT_RUN and "|" not in command.words and command.marker.what != "not run":
        pytest.fail(f"{command}: {program} is not in NOT_RUN; say why a test does not start it")


def _check_make(command: Command, words: list[str]) -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for word in words[1:]:
        if word == "&&" or "=" in word or word in ("make", "hil"):
            break
        assert word in targets, f"{command}: the Makefile has no target {word}"


def _check_python(command: Command, arguments: list[str]) -> None:
    if arguments[:2] == ["-m", "hil.record"]:
        recorder_parser().parse_args(arguments[2:])
    elif arguments[:1] == ["-m"] and arguments[1] in ("controller", "plant_sim"):
        parse_node(arguments[2:], program=arguments[1])
    elif arguments[:1] == ["-c"]:
        compile(arguments[1], str(command), "exec")
    else:
        assert arguments[0] in FILES or (ROOT / arguments[0]).exists(), f"{command}: no file {arguments[0]}"


def _check_hil(command: Command, arguments: list[str], folder: Path, monkeypatch) -> None:
    arguments = _without_redirection(arguments)
    _parse(command, arguments, all_arguments=True)
    what = command.marker.what
    if what in ("parse", "not run"):
        return
    wanted = command.marker.code or 0
    verbs = tuple(word for word in arguments if not word.startswith("-"))
    if what == "run":
        if arguments[0] == "run":
            arguments = [*arguments, *command.marker.words.split()]
        _run(command, _with_run(arguments, folder), wanted)
    elif arguments[0] == "run":
        _rehearse(command, arguments, monkeypatch, command.marker.code)
    elif verbs[:2] in QUICK or (verbs[:1] in QUICK and (verbs[:1] != ("study",) or len(verbs) == 1)):
        needs_bus = verbs[0] == "bus" and verbs[1] != "analyse" and not any(map(RUN_NAMES.match, arguments))
        if not needs_bus:
            _run(command, _with_run(arguments, folder), wanted)


def _parse(command: Command, arguments: list[str], *, all_arguments: bool) -> None:
    """Let the real parser read it; without `all_arguments` missing ones are no error."""
    words = [word for word in arguments if not PLACEHOLDER.search(word)] if not all_arguments else arguments
    node = typer.main.get_command(_app(words))
    while getattr(node, "commands", None) and words and not words[0].startswith("-"):
        if words[0] not in node.commands:
            pytest.fail(f"{command}: there is no command {words[0]}")
        node, words = node.commands[words[0]], words[1:]
    if getattr(node, "commands", None) or words[:1] in (["--help"], ["-h"]):
        return
    try:
        node.make_context("hil", list(words))
    except Exception as error:
        if not all_arguments and type(error).__name__ == "MissingParameter":
            return
        if not all_arguments and "requires an argument" in str(error):
            return
        say = getattr(error, "format_message", None)
        pytest.fail(f"{command}: {say() if say else error}")


def _without_redirection(words: list[str]) -> list[str]:
    for sign in (">", "2>", "<"):
        if sign in words:
            words = words[: words.index(sign)]
    return words


def _with_run(arguments: list[str], folder: Path) -> list[str]:
    """Names of runs that are not there become the one that is."""
    resolved = []
    for before, word in zip(["", *arguments], arguments, strict=False):
        is_run = RUN_NAMES.match(word) or word == "results"
        missing = is_run and before != "--out" and not (folder / word / "run.rrd").exists()
        resolved.append("RUN" if missing else word)
    return resolved


def _run(command: Command, arguments: list[str], wanted: int) -> None:
    printed = io.StringIO()
    with redirect_stdout(printed):
        code = main(arguments)
    assert code == wanted, f"{command}: exit code {code} instead of {wanted}\n{printed.getvalue()[-2000:]}"


class _Rehearsed(Exception):
    """Everything up to the start of the run was right."""

    exit_code = 77


def _rehearse(command: Command, arguments: list[str], monkeypatch, wanted: int | None) -> None:
    """`hil run` up to where it would start processes: scenario, overrides, bus options, log formats."""

    def instead(*_: object, **__: object) -> None:
        raise _Rehearsed

    if any(word in ("…", "KEY=VALUE", "RUN") for word in arguments):
        return
    with monkeypatch.context() as patched:
        patched.setattr(hil.bench.run, "run_scenario", instead)
        _run(command, arguments, _Rehearsed.exit_code if wanted is None else wanted)
