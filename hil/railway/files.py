"""Reading TOML and saying in one line what is wrong with it: file, dotted key, value, limit."""

from __future__ import annotations

import tomllib
import types
import typing
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from hil.railway.errors import RailwayDataError

SCHEMA = 1
"""Version of the file formats of lines, trains and scenarios."""


Model = TypeVar("Model", bound=BaseModel)


class FileModel(BaseModel):
    """Base of what a TOML table may hold: unknown keys, wrong types, nan and inf are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def read_toml(path: Path) -> dict[str, Any]:
    """Contents of a TOML file; RailwayDataError if it is missing, unreadable, empty or not TOML."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RailwayDataError(f"{path}: no such file") from None
    except OSError as error:
        raise RailwayDataError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError as error:
        raise RailwayDataError(f"{path}: not UTF-8 text (byte {error.start})") from None
    except tomllib.TOMLDecodeError as error:
        raise RailwayDataError(f"{path}: not valid TOML: {one_line(str(error))}") from None
    if not tables:
        raise RailwayDataError(f"{path}: is empty")
    return tables


def validate(model: type[Model], tables: Any, path: Path, prefix: str = "") -> Model:
    """Validated model of a table; RailwayDataError says what is wrong, see `describe_validation_error`."""
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        raise RailwayDataError(describe_validation_error(error, path, prefix, model=model)) from None


def describe_validation_error(
    error: ValidationError, file: Path | str, prefix: str = "", *, model: type[BaseModel] | None = None
) -> str:
    """One line `file: dotted.key: value must be …`, with the number of further errors, if any.

    `prefix` is the dotted key of the table that was validated ("controller"). Entries of a list are
    counted from 1: `balises#3.number`. With `model` an unknown key names the keys that exist.
    """
    problems = error.errors(include_url=False)
    first = problems[0]
    key = _dotted_key(first["loc"], prefix)
    where = f"{file}: {key}: " if key else f"{file}: "
    more = len(problems) - 1
    suffix = f" (and {more} more {'error' if more == 1 else 'errors'})" if more else ""
    return where + one_line(_what(dict(first), model)) + suffix


def one_line(text: str) -> str:
    """Text with every run of white space, line breaks included, as one space."""
    return " ".join(text.split())


def choices(wanted: str, known: Sequence[str]) -> str:
    """`it has a, b, c`, with the nearest name first if `wanted` looks like a slip."""
    if not known:
        return "there is none"
    near = get_close_matches(wanted, known, n=1)
    return (f"did you mean {near[0]}? " if near else "") + "it has " + ", ".join(known)


_LIMITS = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
    "multiple_of": ("multiple_of", "must be a multiple of"),
    "literal_error": ("expected", "must be"),
    "enum": ("expected", "must be"),
    "string_pattern_mismatch": ("pattern", "must match"),
    "string_too_short": ("min_length", "must have a length of at least"),
    "string_too_long": ("max_length", "must have a length of at most"),
}
_KINDS = {
    "finite_number": "must be a finite number",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_from_float": "must be a whole number",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "string_type": "must be text",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "model_attributes_type": "must be a table",
}


def _dotted_key(location: Sequence[int | str], prefix: str) -> str:
    key = prefix
    for part in location:
        if isinstance(part, int):
            key += f"#{part + 1}"
        else:
            key += f".{part}" if key else part
    return key


def _what(problem: dict[str, Any], model: type[BaseModel] | None) -> str:
    kind, context = problem["type"], problem.get("ctx", {})
    value = _shown(problem["input"])
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        known = _known_keys(model, problem["loc"][:-1])
        return "unknown key" + (f"; {choices(str(problem['loc'][-1]), known)}" if known else "")
    if kind == "value_error":  # raised by a validator of ours, which names what it needs to name
        return str(context.get("error", problem["msg"]))
    if kind == "too_short":
        return f"must have at least {context['min_length']} entries, has {context['actual_length']}"
    if kind == "too_long":
        return f"must have at most {context['max_length']} entries"
    if kind in _LIMITS:
        name, text = _LIMITS[kind]
        return f"{value} {text} {context[name]}"
    if kind in _KINDS:
        return f"{value} {_KINDS[kind]}"
    return f"{value}: {problem['msg']}"


def _shown(value: Any) -> str:
    """The value as the user wrote it, or nearly so; a long one is cut."""
    if isinstance(value, bool):
        return str(value).lower()
    text = one_line(repr(value))
    return text if len(text) <= 60 else text[:57] + "..."


def _known_keys(model: type[BaseModel] | None, location: Sequence[int | str]) -> list[str]:
    """Keys that the table at this location may have, found by walking the model's annotations."""
    for part in location:
        if model is None:
            return []
        if isinstance(part, str):
            fields = [f for name, f in model.model_fields.items() if part in (name, f.alias)]
            model = _model_in(fields[0].annotation) if fields else None
    if model is None:
        return []
    return [field.alias or name for name, field in model.model_fields.items()]


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    for argument in typing.get_args(annotation):
        found = _model_in(argument)
        if found is not None:
            return found
    return None
