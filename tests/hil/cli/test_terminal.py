"""What a terminal shows: help that teaches by example, completion, suggestions, the picture of a run."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys

import pytest
from rich.console import Console
from rich.text import Text

from hil.bench.scenario import load_scenario
from hil.bench.watch import View
from hil.cli import COMMANDS, main
from hil.cli.gauges import Strip, gauge, sparkline
from hil.cli.progress import Progress
from hil.cli.teaching import help_text

BUS_COMMANDS = [f"bus {name}" for name in ("analyse", "load", "dump", "up", "down", "statistics")]


def hil(*words, **environment):
    return subprocess.run(
        [sys.executable, "-m", "hil", *words],
        capture_output=True, text=True, timeout=60, check=False,
        env={**os.environ, "COLUMNS": "80", **environment},
    )  # fmt: skip


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    return load_scenario("cat_linh_la_thanh", scratch=tmp_path_factory.mktemp("scenario"))


# -- help -------------------------------------------------------------------------------------------


def test_the_list_of_commands_is_told_without_loading_any_of_them():
    code = (
        "import sys; from hil.cli import main; main(['--help']);"
        "sys.exit(any(n in sys.modules for n in ('can', 'rerun', 'numba', 'hil.cli.run')))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0
    listed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("│ ")]
    assert [word for word in listed if word in COMMANDS] == list(COMMANDS)


@pytest.mark.parametrize("command", [*(name for name in COMMANDS if name != "bus"), *BUS_COMMANDS])
def test_help_shows_examples_that_fit_80_columns(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERMINAL_WIDTH", "80")
    assert main([*command.split(), "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    at = next(k for k, line in enumerate(lines) if line.strip() == "Examples")
    block = []
    for line in lines[at + 1 :]:
        if not line.strip():
            break
        block.append(line)
    assert sum(line.startswith(f"   hil {command}") for line in block) >= 1
    assert all(line.startswith("   ") for line in block)  # nothing was broken
    assert max(map(len, lines)) <= 80


def test_defaults_in_square_brackets_are_shown(capsys):
    assert main(["run", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "[runs/<time>-<scenario>]" in shown
    assert "[bit/s]" in shown


def test_examples_that_do_not_fit_beside_go_below():
    doc = "Do it.\n\n[bold]hil do A[/bold]   first\n\n[bold]hil do B --much[/bold]  " + "word " * 10
    wide, narrow = help_text(doc, 120), help_text(doc, 60)
    assert "[bold]hil do A[/bold]" + " " * 9 + "first" in wide
    assert "[bold]hil do A[/bold]\n      first" in narrow


def test_a_command_that_is_too_long_is_continued_as_a_shell_takes_it():
    shown = help_text("Do it.\n\n[bold]hil do " + "--word " * 12 + "[/bold]", 60)
    drawn = Text.from_markup(shown.partition("\b\n")[2]).plain
    assert " \\\n      --word" in drawn


# -- completion and suggestions ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("typed", "word"),
    [
        ("hil re", "replay"),
        ("hil run metro_1500m_3", "metro_1500m_305t"),
        ("hil run --law fuzzy_", "fuzzy_d"),
        ("hil run --set controller.law=p", "controller.law=pid"),
        ("hil replay --node p", "plant_sim"),
    ],
)
def test_the_shell_completes(typed, word, capsys, monkeypatch):
    monkeypatch.setenv("_HIL_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    assert word in capsys.readouterr().out.split()


def test_runs_complete_the_newest_first(tmp_path, monkeypatch):
    from hil.cli.completion import complete_runs

    monkeypatch.chdir(tmp_path)
    for name in ("20260101-a", "20260102-b"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / "scenario.toml").touch()
    (tmp_path / "runs" / "no-run").mkdir()
    assert [word for word, _ in complete_runs("runs/2")][:2] == ["runs/20260102-b", "runs/20260101-a"]
    assert complete_runs("nowhere/") == []


def test_completion_can_be_installed():
    # Which shell called is told to typer, not found out: in CI it is make's sh, which has no completion.
    done = hil("--show-completion", "bash", _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert done.returncode == 0
    assert "_hil_completion" in done.stdout


def test_an_unknown_command_names_the_nearest(capsys):
    assert main(["rnu"]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "'run'" in shown.err
    assert len(shown.err.strip().splitlines()) == 1


def test_json_is_one_document(capsys):
    assert main(["list", "--json"]) == 0
    assert "cat_linh_la_thanh" in json.loads(capsys.readouterr().out)["scenarios"]


# -- the picture of a run ---------------------------------------------------------------------------


def view_at(position_m, **more):
    told = {
        "time_s": 40.0, "position_m": position_m, "speed_mps": 10.0, "reference_speed_mps": 10.5,
        "distance_to_stop_m": 931.0 - position_m, "mode": "RUN", "supervision": "NORMAL",
        "permitted_speed_mps": 16.2,
    }  # fmt: skip
    return View(**{**told, **more})


@pytest.mark.parametrize("width", [80, 120])
def test_the_picture_fits_the_terminal_and_the_train_moves(scenario, width):
    console = Console(width=width, file=io.StringIO(), force_terminal=True, color_system=None)
    progress = Progress(scenario, console=console)
    places = []
    for position_m in (0.0, 465.0, 931.0):
        with console.capture() as captured:
            console.print(progress.picture(view_at(position_m, deadline_misses=3)))
        lines = captured.get().splitlines()
        assert len(lines) == 4
        assert max(map(len, lines)) < width
        places.append(lines[1].index("▶"))
    assert places[0] < places[1] < places[2]
    assert "36.00 km/h" in lines[2]
    assert "misses 3" in lines[3]


def test_a_pipe_gets_plain_lines_and_not_many(scenario):
    out = io.StringIO()
    with Progress(scenario, console=Console(file=out, width=80)) as progress:
        for tick in range(200):
            progress.show(view_at(10.0 + tick))
    assert len(out.getvalue().splitlines()) == 1
    assert "\x1b" not in out.getvalue()
    assert "v  36.00 km/h" in out.getvalue()


def test_no_color_is_respected(scenario, monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")
    console = Console(width=80, file=io.StringIO(), force_terminal=True)
    with console.capture() as captured:
        console.print(Progress(scenario, console=console).picture(view_at(100.0)))
    assert "\x1b[3" not in captured.get()  # no colour of text


def test_the_strip_is_a_journey_from_left_to_right(scenario):
    strip = Strip(scenario.journey, 40)
    assert strip.column(scenario.journey.origin.position_m) == 0
    assert strip.column(scenario.journey.destination.position_m) == 39
    assert len(set(strip.limits(0.0).plain)) > 1  # a lower limit on the way is seen
    assert len(strip.track(-5.0).plain) == len(strip.track(5000.0).plain) == 40


def test_the_gauge_puts_speed_reference_and_limit_on_one_scale():
    text = gauge(10.0, 12.0, 16.0, full=20.0, width=21).plain
    assert text == "██████████··│···▏····"


def test_a_sparkline_has_zero_in_its_middle_and_leaves_noise_flat():
    assert sparkline([-1.0, 0.0, 1.0]) == "▁▄▇"
    assert len(set(sparkline([1e-4, -1e-4, 0.0]))) == 1
