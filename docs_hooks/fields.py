"""The fields of a pydantic model or dataclass as a reader needs them: key, type, limits, default, meaning.

The meaning is what the source says beside the field: the string below it, or the comment at the end of its
line. So the reference says what the code says.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import re
import textwrap
import tokenize
import types
import typing
from dataclasses import dataclass
from typing import Any

from pieces import number
from pydantic import BaseModel

UNITS = {
    "mps": "m/s", "mps2": "m/s²", "mps3": "m/s³", "kmh": "km/h", "m": "m", "s": "s", "us": "µs", "n": "N",
    "kn": "kN", "kw": "kW", "t": "t", "permille": "‰", "rad": "rad", "radps": "rad/s", "per_s": "1/s",
    "per_s2": "1/s²", "n_per_kn": "N/kN", "n_per_mps": "N s/m", "n_per_mps2": "N s²/m²", "bitrate": "bit/s",
    "n_per_kn_per_kmh": "N/kN per km/h", "n_per_kn_per_kmh2": "N/kN per (km/h)²",
}  # fmt: skip
"""By the end of the key, which is where the unit of a quantity stands."""

KINDS = {float: "number", int: "integer", str: "text", bool: "true or false"}


@dataclass(frozen=True)
class Field:
    """One key of a table."""

    key: str
    kind: str
    limits: str
    default: str
    unit: str
    meaning: str
    model: type[BaseModel] | None
    """The model of the table, or of each entry of the list of tables, that stands here."""
    is_list: bool


def fields(model: type[BaseModel]) -> list[Field]:
    """All fields of a model, in the order of the source."""
    notes = meanings(model)
    found = []
    for name, info in model.model_fields.items():
        inner, is_list = _model_of(info.annotation)
        found.append(
            Field(
                key=info.alias or name,
                kind=_kind(info.annotation),
                limits=_limits(info.metadata, info.annotation),
                default=_default(info),
                unit=unit_of(name),
                meaning=notes.get(name, ""),
                model=inner,
                is_list=is_list,
            )
        )
    return found


def unit_of(name: str) -> str:
    """Unit that the end of a key names; empty if it names none."""
    parts = name.strip("_").split("_")
    for start in range(len(parts)):
        unit = UNITS.get("_".join(parts[start:]))
        if unit and (start or name in ("bitrate", "permille")):
            return unit
    return ""


def meanings(owner: type) -> dict[str, str]:
    """What the source says of each field of a class and of the classes it stands on."""
    notes: dict[str, str] = {}
    for base in reversed(owner.__mro__):
        if base in (object, BaseModel) or not (
            issubclass(base, BaseModel) or dataclasses.is_dataclass(base) or base is owner
        ):
            continue
        notes |= _notes(base)
    return notes


def _notes(owner: type) -> dict[str, str]:
    try:
        source = textwrap.dedent(inspect.getsource(owner))
    except (OSError, TypeError):
        return {}
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT and "fmt:" not in token.string and "noqa" not in token.string
    }
    definition = ast.parse(source).body[0]
    assert isinstance(definition, ast.ClassDef)
    notes: dict[str, str] = {}
    for statement, following in zip(definition.body, [*definition.body[1:], None], strict=True):
        if not (isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)):
            continue
        lines = range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
        text = " ".join(comments[line] for line in lines if line in comments)
        if isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant):
            text = " ".join(str(following.value.value).split())
        notes[statement.target.id] = text
    return notes


def _kind(annotation: Any) -> str:
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return _kind(arguments[0])
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_kind(kind) for kind in arguments if kind is not type(None))
    if origin is typing.Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin is list or (origin is tuple and Ellipsis in arguments):
        return "list of tables" if _model_of(annotation)[0] else f"list of {_kind(arguments[0])}s"
    if origin is tuple:
        return f"list of {len(arguments)} {_kind(arguments[0])}s"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "table"
    return KINDS.get(annotation, "table" if origin is dict else str(annotation))


def _model_of(annotation: Any) -> tuple[type[BaseModel] | None, bool]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation, False
    is_list = typing.get_origin(annotation) in (list, tuple)
    for inner in typing.get_args(annotation):
        model, nested = _model_of(inner)
        if model is not None:
            return model, is_list or nested
    return None, False


SIGNS = (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))


def _limits(metadata: list[Any], annotation: Any) -> str:
    found = []
    for limit in [*metadata, *_inner_metadata(annotation)]:
        for nested in [limit, *getattr(limit, "metadata", [])]:
            for name, sign in SIGNS:
                value = getattr(nested, name, None)
                if value is not None:
                    found.append(f"{sign} {number(value)}")
            for name, word in (("min_length", "at least"), ("max_length", "at most")):
                if getattr(nested, name, None):
                    found.append(f"length {word} {getattr(nested, name)}")
            pattern = getattr(nested, "pattern", None)
            if pattern:
                found.append("letters, digits, `_`, `-`" if re.match(r"\^\[A-Za-z0-9", pattern) else pattern)
    return ", ".join(dict.fromkeys(found))


def _inner_metadata(annotation: Any) -> list[Any]:
    """Limits inside `X | None` and lists; not those inside a model."""
    found: list[Any] = []
    for inner in typing.get_args(annotation):
        found += list(getattr(inner, "__metadata__", ()))
        found += _inner_metadata(inner)
    return found


def _default(info: Any) -> str:
    if info.is_required():
        return "required"
    value = info.get_default(call_default_factory=True)
    if value is None or isinstance(value, BaseModel) or value in ((), [], {}, ""):
        return ""
    return f"`{number(value)}`" if not isinstance(value, str) else f'`"{value}"`'
