"""The pages of the files that a user writes: scenario, line, train; from the models that validate them."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from fields import Field, fields, meanings, unit_of
from notes import LINE, SCENARIO, TRAIN
from pieces import cell, code, number, table
from pydantic import BaseModel

from controller.config import ControllerConfig
from controller.laws.selection import LAWS
from hil.bench import scenario as scenario_file
from hil.railway.journey import JourneyTable
from hil.railway.line_file import LineFile
from hil.railway.train_file import TrainFile
from plant_sim.config import PlantConfig

NAMES_ONLY = re.compile(r"(The (whole )?table|An entry of) `[^`]*`\.")
"""A docstring that says no more than the heading."""
ROLE = re.compile(r":(?:mod|class|func):`([^`]*)`")
HEADS = ["key", "type", "limits", "default", "unit", "meaning"]
TABLES: dict[str, type[BaseModel]] = {
    "journey": JourneyTable,
    "controller": ControllerConfig,
    "plant": PlantConfig,
}
"""Tables of a scenario that somebody else than the bench validates."""


def scenario_page() -> str:
    """Markdown of the whole scenario file."""
    lines = _start(
        "Scenario file",
        "One TOML file says which train runs where, under which law, on which bus, and what passes. Every key"
        " can be given on the command line: `hil run --set controller.law=pid`. Unknown keys, wrong types and"
        " values beyond a limit are errors with file, key, value and limit, before anything is started.",
        "scenarios/cat_linh_la_thanh.toml",
    )
    model = scenario_file._File
    top = [
        dataclasses.replace(field, model=TABLES.get(field.key, field.model), kind="table")
        if field.key in TABLES
        else field
        for field in fields(model)
    ]
    return "\n".join(lines + _tables(top, "", SCENARIO))


def line_page() -> str:
    """Markdown of the line file."""
    about = (
        "Lengths in m, speeds in km/h, gradients in ‰. A line has one direction of travel; the way back is"
        " another file. TTOBench track files (JSON) are read as they are."
    )
    lines = _start("Line file", about, "lines/cat_linh_la_thanh.toml")
    return "\n".join(lines + _tables(fields(LineFile), "", LINE))


def train_page() -> str:
    """Markdown of the train file."""
    about = (
        "Masses in t, efforts in kN, power in kW, speeds in km/h. Either `[davis]` or `[specific_davis]` must"
        " be there. TTOBench train files (JSON) are read as they are, with a drive of our choice behind them."
    )
    lines = _start("Train file", about, "trains/cat_linh_4car.toml")
    return "\n".join(lines + _tables(fields(TrainFile), "", TRAIN))


def _start(title: str, about: str, example: str) -> list[str]:
    text = (files("hil.library") / example).read_text(encoding="utf-8").rstrip()
    name = example.rsplit("/", 1)[1]
    return [
        f"# {title}", "",
        f"Generated from the models that read the file. {about}", "",
        f'??? example "The shipped {name}"', "",
        "    ```toml", *("    " + line if line else "" for line in text.splitlines()), "    ```", "",
    ]  # fmt: skip


def _tables(found: list[Field], path: str, notes: Mapping[str, str]) -> list[str]:
    lines = []
    own = [field for field in found if field.model is None]
    if own:
        lines += table(HEADS, [_row(field, _dotted(path, field.key), notes) for field in own])
    for field in found:
        if field.model is not None:
            lines += _model(field, _dotted(path, field.key), notes)
    return lines


def _dotted(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key


def _model(field: Field, path: str, notes: Mapping[str, str]) -> list[str]:
    assert field.model is not None
    brackets = f"[[{path}]]" if field.is_list else f"[{path}]"
    level = "##" if "." not in path else "###"
    lines = [f"{level} `{brackets}` {{#{path.replace('.', '-')}}}", ""]
    law = path.removeprefix("controller.")
    if path.startswith("controller.") and law in LAWS:
        return lines + _law(law, field.model, notes)
    about = inspect.cleandoc(field.model.__doc__ or "").split("\n\n")
    lines += [cell(_shown(part)) + "\n" for part in about if not NAMES_ONLY.fullmatch(part)]
    return lines + _tables(fields(field.model), path, notes)


def _law(name: str, model: type[BaseModel], notes: Mapping[str, str]) -> list[str]:
    """A law's table: its defaults are those of a preset, which stand in the law's own parameters."""
    presets: list[Any] = [_parameters(model, preset) for preset in ("train", "paper")]
    in_the_law = meanings(type(presets[0]))
    rows = []
    for field in fields(model):
        train, paper = (getattr(preset, field.key, None) for preset in presets)
        default = field.default if train is None else code(_value(train))
        printed = "" if paper is None or paper == train else code(_value(paper))
        said = field.meaning or in_the_law.get(field.key, "")
        meaning = said or notes.get(f"controller.{name}.{field.key}", "")
        if field.key == "preset":
            meaning = "For a train on a bus, or as the law's paper prints it."
        rows.append([
            code(field.key), field.kind, field.limits, default, printed, field.unit or unit_of(field.key),
            cell(_shown(meaning)),
        ])  # fmt: skip
    heads = ["key", "type", "limits", "train", "paper", "unit", "meaning"]
    return [f"{LAWS[name].title}. [How it works](../laws.md#{name})", "", *table(heads, rows)]


def _parameters(model: Any, preset: str) -> Any:
    return model(preset=preset).parameters()


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(number(part) for part in value) + "]"
    return number(value)


def _row(field: Field, path: str, notes: Mapping[str, str]) -> list[str]:
    meaning = cell(_shown(field.meaning or notes.get(path, "")))
    return [code(field.key), field.kind, field.limits, field.default, field.unit, meaning]


def _shown(text: str) -> str:
    """Text of a docstring without the marks of reStructuredText."""
    return ROLE.sub(r"`\1`", text)
