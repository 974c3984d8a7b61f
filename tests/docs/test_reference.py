"""The generated pages say everything, and the schema of the summary is the one that runs keep."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import pytest

import hil.cli
from hil.canbus.contract import Contract

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def pages():
    import generate

    return {name: page() for name, page in generate.PAGES.items()}


@pytest.mark.parametrize("name", ["reference/scenario.md", "reference/line.md", "reference/train.md"])
def test_every_key_of_a_file_has_a_meaning(pages, name):
    rows = [line for line in pages[name].splitlines() if line.startswith("| `")]
    assert len(rows) > 10
    assert not [row for row in rows if re.split(r"(?<!\\)\|", row)[-2].strip() == ""]


def test_every_table_of_the_scenario_is_there(pages):
    for path in ("journey", "controller.profile", "controller.fuzzy_d", "plant.atp.restrictions", "timing"):
        assert f"[{path}]" in pages["reference/scenario.md"], path


def test_a_default_and_a_limit_are_those_of_the_model(pages):
    row = next(line for line in pages["reference/scenario.md"].splitlines() if "`stop_braking_s`" in line)
    assert "`1.5`" in row
    assert "≥ 0, ≤ 10" in row


def test_every_command_and_option_is_on_the_page_of_the_command_line(pages):
    import typer

    root = typer.main.get_command(hil.cli._app([]))
    for name, command in root.commands.items():
        assert f"## hil {name} " in pages["reference/cli.md"]
        for parameter in command.params:
            if parameter.opts[0].startswith("--"):
                assert parameter.opts[0] in pages["reference/cli.md"]


def test_every_message_and_signal_of_the_contract_is_in_the_table(pages):
    text = pages["reference/dbc.md"]
    for codec in Contract.load().messages.values():
        section = text.split(f"## {codec.name} {{")[1].split("\n## ")[0]
        assert f"`0x{codec.can_id:03X}`" in section
        for signal in codec.signals:
            assert f"| `{signal.name}` |" in section


def test_a_real_summary_keeps_the_schema_and_has_no_key_that_it_lacks(recorded):
    schema = json.loads((ROOT / "docs/reference/summary.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads((recorded / "summary.json").read_text()), schema)


def test_the_schema_refuses_a_summary_without_verdict(recorded):
    schema = json.loads((ROOT / "docs/reference/summary.schema.json").read_text())
    summary = json.loads((recorded / "summary.json").read_text())
    del summary["verdict"]
    with pytest.raises(jsonschema.ValidationError, match="verdict"):
        jsonschema.validate(summary, schema)
