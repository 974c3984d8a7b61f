"""The command line `hil`: one file per command.

Exit code 0: passed; 1: ran, verdict failed; 2: bad input; 3: something it needs is missing or died.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Protocol, runtime_checkable

import typer

from hil import __version__
from hil.cli.teaching import summary_of, teach, teach_group

COMMANDS = {
    "run": "run",
    "list": "list_",
    "view": "view",
    "replay": "replay",
    "profile": "profile",
    "study": "study",
    "compare": "compare_",
    "timing": "timing",
    "export": "export",
    "query": "query",
    "report": "report",
    "doctor": "doctor",
    "bus": "bus",
}
"""Function of each command, in the module of that name. Only the one asked for is imported: a viewer
library and a compiler are not loaded to say that a file is missing.
"""

COMPLETING = "_HIL_COMPLETE"
"""Set in the environment by the shell's completion."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; errors are one line on standard error and an exit code."""
    words = [*(sys.argv[1:] if arguments is None else arguments)]
    try:
        code = _app(_typed(words))(args=words, standalone_mode=False, prog_name="hil")
        return code if isinstance(code, int) else 0
    except typer.Exit as stop:
        return stop.exit_code
    except (typer.Abort, KeyboardInterrupt):
        return _fail("hil: aborted", 1)
    except BrokenPipeError:
        # The reader of our output went away (`hil list | head`): not an error of ours.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        if isinstance(error, _ParserError):
            if type(error).__name__ == "NoArgsIsHelpError":
                typer.echo(error.format_message())
                return 2
            return _fail(_usage_line(error), 2)
        code = getattr(error, "exit_code", None)
        if isinstance(code, int):
            return _fail(f"hil: {error}", code)
        if os.environ.get("HIL_TRACEBACK") == "1":
            traceback.print_exc()
        return _fail(f"hil: internal error: {type(error).__name__}: {error} (HIL_TRACEBACK=1 shows where)", 3)


def _app(words: Sequence[str]) -> typer.Typer:
    """The application with the command that `words` asks for, or with all of them for help."""
    app = typer.Typer(
        help="Hardware-in-the-loop bench for Automatic Train Operation.\n\n"
        "Start with: [bold]hil run[/bold] (drive a train in real time), then [bold]hil view runs/…[/bold].",
        no_args_is_help=True,
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    asked = next((word for word in words if not word.startswith("-")), None)
    if asked in COMMANDS:
        _add(app, str(asked))
    else:
        for name, function in COMMANDS.items():
            path = Path(__file__).parent / f"{name}.py"
            app.command(name=name, help=summary_of(path, function))(_not_loaded)
    app.callback()(_options)
    return app


def _add(app: typer.Typer, name: str) -> None:
    """Import a command, or a group of commands."""
    command = getattr(import_module(f"hil.cli.{name}"), COMMANDS[name])
    if isinstance(command, typer.Typer):
        teach_group(command)
        app.add_typer(command, name=name)
    else:
        app.command(name=name, help=teach(command))(command)


def _not_loaded() -> None:
    """Stands for a command in the list of all; the one that is to run is imported instead."""


def _typed(words: Sequence[str]) -> Sequence[str]:
    """The words of the command line; while the shell completes one, those that stand there so far."""
    if COMPLETING not in os.environ:
        return words
    return (os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS") or "").split()[1:]


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"hil {__version__}")
        raise typer.Exit


def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
) -> None:
    pass


@runtime_checkable
class _ParserError(Protocol):
    """An error of the argument parser: click's, or those of the copy of click inside newer typers."""

    def format_message(self) -> str: ...


def _usage_line(error: _ParserError) -> str:
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "hil"
    parameter = getattr(error, "param", None)
    name = "/".join(parameter.opts) + ": " if parameter is not None and parameter.opts else ""
    text = error.format_message()
    return f"{command}: {'' if name.strip(': ') in text else name}{text} (try {command} --help)"


def _fail(line: str, code: int) -> int:
    print(" ".join(line.split()), file=sys.stderr)
    return code
