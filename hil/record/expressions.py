"""A small language of numbers out of a recording: max(abs(ODO_Motion.Speed - ATO_Status.ReferenceSpeed)).

Python's grammar, read by Python's parser; only names, numbers, arithmetic, comparisons, `and`, `or`, `not`
and the functions of FUNCTIONS are let through, so an expression can do nothing but compute.

Two signals meet at the stamps of the left one, the right one holding its latest value until then. Units go
along: what is added or compared is brought to the unit of the left side, and refused if it has another kind.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.record.charts import conversion
from hil.record.errors import RecordError

__all__ = ["FUNCTIONS", "ExpressionError", "Quantity", "evaluate"]

Array = NDArray[np.float64]

FUNCTIONS = {
    "max": "max(x): the highest",
    "min": "min(x): the lowest",
    "mean": "mean(x)",
    "rms": "rms(x): root of the mean square",
    "std": "std(x): standard deviation",
    "p50": "p50(x), p99(x), p999(x): percentiles 50, 99, 99.9",
    "percentile": "percentile(x, 95)",
    "count": "count(x): samples; of a condition, those where it holds",
    "first": "first(x), last(x): the first and the last value",
    "sum": "sum(x)",
    "abs": "abs(x), sqrt(x)",
    "diff": "diff(x): from each sample to the next",
    "rate": "rate(x): diff over time, per second",
    "where": "where(x, condition): the samples of x where the condition holds",
    "between": "between(x, t0, t1): the samples of x from t0 to t1 s",
    "at": "at(x, t): the value of x at t s",
    "time": "time(x): when the samples of x are, s since the start",
}
"""The functions by name, each with what it gives."""


class ExpressionError(RecordError):
    """An expression cannot be read, or makes no sense."""


class Samples(Protocol):
    """What an expression asks a recording for: a column with stamps, values and a unit."""

    @property
    def bus_time_ns(self) -> NDArray[np.int64]: ...
    @property
    def sim_time_s(self) -> Array: ...
    @property
    def values(self) -> Array: ...
    @property
    def unit(self) -> str: ...


@dataclass(frozen=True)
class Quantity:
    """A number, or n samples at `stamps_ns` (n), `seconds` (n) since the start; `unit` is "" for none."""

    values: Array
    unit: str = ""
    stamps_ns: NDArray[np.int64] | None = None
    seconds: Array | None = None
    condition: bool = False

    @property
    def is_series(self) -> bool:
        """Whether this is samples, not one number."""
        return self.stamps_ns is not None


def evaluate(text: str, column: Callable[[str], Samples]) -> Quantity:
    """The value of an expression; `column` finds a signal by its name and raises if there is none.

    Raises ExpressionError.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except SyntaxError as error:
        place = f" at {text.strip()[(error.offset or 1) - 1 :][:12]!r}" if error.offset else ""
        raise ExpressionError(f"{text!r}: not an expression: {error.msg}{place}") from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise ExpressionError(f"{text[:60]!r}: not an expression: {error}") from None
    with np.errstate(all="ignore"):
        return _Evaluation(text, column).of(tree.body)


BINARY: Mapping[type[ast.operator], tuple[str, Callable[[Any, Any], Any]]] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
    ast.Pow: ("**", operator.pow),
    ast.Mod: ("%", operator.mod),
}
COMPARE: Mapping[type[ast.cmpop], tuple[str, Callable[[Any, Any], Any]]] = {
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}
REDUCE: Mapping[str, Callable[[Array], Any]] = {
    "max": np.max,
    "min": np.min,
    "mean": np.mean,
    "rms": lambda x: np.sqrt(np.mean(x * x)),
    "std": np.std,
    "p50": lambda x: np.percentile(x, 50),
    "p99": lambda x: np.percentile(x, 99),
    "p999": lambda x: np.percentile(x, 99.9),
    "first": lambda x: x[0],
    "last": lambda x: x[-1],
    "sum": np.sum,
}


class _Evaluation:
    """Walks one expression."""

    def __init__(self, text: str, column: Callable[[str], Samples]) -> None:
        self._text = text
        self._column = column

    def of(self, node: ast.expr) -> Quantity:
        match node:
            case ast.Constant(value=bool()) | ast.Constant(value=str()):
                raise self._error(f"{node.value!r} is not a number")
            case ast.Constant(value=int() | float() as number):
                return _plain(number)
            case ast.Attribute() | ast.Name():
                return self._signal(node)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.of(operand)
                return replace(inner, values=-inner.values, condition=False)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self.of(operand)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                inner = self.of(operand)
                return replace(inner, values=_truth(inner.values == 0), unit="", condition=True)
            case ast.BinOp(op=op) if type(op) in BINARY:
                return self._binary(*BINARY[type(op)], self.of(node.left), self.of(node.right))
            case ast.Compare():
                return self._compare(node)
            case ast.BoolOp():
                return self._bool(node)
            case ast.Call(func=ast.Name(id=name), keywords=[]):
                return self._call(name, [self.of(argument) for argument in node.args])
        shown = ast.get_source_segment(self._text.strip(), node) or type(node).__name__
        raise self._error(f"{shown!r} is not allowed; arithmetic, comparisons and functions are")

    def _signal(self, node: ast.Attribute | ast.Name) -> Quantity:
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            column = self._column(f"{node.value.id}.{node.attr}")
            return Quantity(column.values, column.unit, column.bus_time_ns, column.sim_time_s)
        shown = ast.unparse(node)
        raise self._error(f"{shown!r} is not a signal; they are written Message.Signal or process.name")

    def _binary(
        self, sign: str, function: Callable[[Any, Any], Any], left: Quantity, right: Quantity
    ) -> Quantity:
        left, right = _meet(left, right)
        unit = ""
        if sign in "+-%":
            right = self._in_unit_of(left, right, sign)
            unit = left.unit or right.unit
        elif sign in "*/" and (left.unit or right.unit):
            unit = _product(sign, left.unit, right.unit)
        elif sign == "**" and left.unit:
            unit = f"({left.unit})^{float(right.values):g}" if not right.is_series else ""
        return _like(left if left.is_series else right, function(left.values, right.values), unit)

    def _compare(self, node: ast.Compare) -> Quantity:
        found: Quantity | None = None
        left = self.of(node.left)
        for op, comparator in zip(node.ops, node.comparators, strict=True):
            if type(op) not in COMPARE:
                raise self._error("only < <= > >= == != compare")
            sign, function = COMPARE[type(op)]
            right = self.of(comparator)
            one, other = _meet(left, right)
            other = self._in_unit_of(one, other, sign)
            held = function(one.values, other.values)
            this = replace(_like(one if one.is_series else other, _truth(held), ""), condition=True)
            found = this if found is None else _both(found, this, np.minimum)
            left = right
        return left if found is None else found  # the grammar says: one comparison at least

    def _bool(self, node: ast.BoolOp) -> Quantity:
        function = np.minimum if isinstance(node.op, ast.And) else np.maximum
        parts = [self.of(value) for value in node.values]
        found = parts[0]
        for part in parts[1:]:
            found = _both(found, part, function)
        return found

    def _call(self, name: str, arguments: list[Quantity]) -> Quantity:
        wanted = {"percentile": 2, "where": 2, "at": 2, "between": 3}.get(name, 1)
        if name not in FUNCTIONS and name not in REDUCE and name != "sqrt":
            raise self._error(f"no function {name!r}; there are {', '.join(FUNCTIONS)}")
        if len(arguments) != wanted:
            takes = FUNCTIONS.get(name, f"{name}(x)")
            raise self._error(f"{name} takes {wanted} argument{'s' * (wanted > 1)}: {takes}")
        first = arguments[0]
        if name in {"abs", "sqrt"}:
            function = np.abs if name == "abs" else np.sqrt
            unit = first.unit if name == "abs" or not first.unit else f"({first.unit})^0.5"
            return replace(first, values=function(first.values), unit=unit, condition=False)
        if not first.is_series or first.stamps_ns is None or first.seconds is None:
            raise self._error(f"{name} needs a signal, not a number")
        if name in REDUCE:
            return _plain(REDUCE[name](self._known(name, first)), first.unit)
        match name:
            case "percentile":
                return _plain(np.percentile(self._known(name, first), self._share(arguments[1])), first.unit)
            case "count":
                known = first.values[np.isfinite(first.values)]
                return _plain(np.count_nonzero(known) if first.condition else len(known))
            case "diff":
                rows = np.arange(1, len(first.values))
                return replace(_take(first, rows), values=np.diff(first.values))
            case "rate":
                rows = np.arange(1, len(first.values))
                steps = np.diff(first.values) / (np.diff(first.stamps_ns) / 1e9)
                return replace(_take(first, rows), values=steps, unit=_product("/", first.unit, "s"))
            case "time":
                return replace(first, values=first.seconds, unit="s", condition=False)
            case "where":
                series, condition = _meet(first, arguments[1])
                holds = np.broadcast_to(condition.values == 1.0, series.values.shape)
                return _take(series, np.flatnonzero(holds))
            case "between":
                begin, end = (self._number(name, argument) for argument in arguments[1:])
                return _take(first, np.flatnonzero((first.seconds >= begin) & (first.seconds <= end)))
            case _:  # at
                row = int(np.searchsorted(first.seconds, self._number(name, arguments[1]), side="right")) - 1
                if row < 0:
                    raise self._error("at: nothing was recorded yet at that time")
                return _plain(first.values[row], first.unit)

    def _known(self, name: str, series: Quantity) -> Array:
        known = series.values[np.isfinite(series.values)]
        if not len(known):
            raise self._error(f"{name} of no samples: the signal was never received, or no condition held")
        return known

    def _number(self, name: str, quantity: Quantity) -> float:
        if quantity.is_series:
            raise self._error(f"{name}: times are numbers [s], not signals")
        return float(quantity.values)

    def _share(self, quantity: Quantity) -> float:
        share = self._number("percentile", quantity)
        if not 0 <= share <= 100:
            raise self._error(f"percentile {share:g}: must be 0 to 100")
        return share

    def _in_unit_of(self, left: Quantity, right: Quantity, sign: str) -> Quantity:
        if left.unit == right.unit or not left.unit or not right.unit:
            return right
        factor = conversion(right.unit, left.unit)
        if factor is None:
            raise self._error(f"{left.unit} {sign} {right.unit}: not the same kind of quantity")
        return replace(right, values=right.values * factor, unit=left.unit)

    def _error(self, text: str) -> ExpressionError:
        return ExpressionError(f"{self._text.strip()}: {text}")


def _meet(left: Quantity, right: Quantity) -> tuple[Quantity, Quantity]:
    """Both at the stamps of the left one, or of the only one that has any."""
    base, other = left.stamps_ns, right.stamps_ns
    if base is None or other is None or (len(base) == len(other) and np.array_equal(base, other)):
        return left, right
    if not len(other):
        held = np.full(len(base), np.nan)
    else:
        latest = np.searchsorted(other, base, side="right") - 1
        held = np.where(latest >= 0, right.values[np.maximum(latest, 0)], np.nan)
    return left, replace(right, values=held, stamps_ns=base, seconds=left.seconds)


def _both(left: Quantity, right: Quantity, function: Callable[[Any, Any], Any]) -> Quantity:
    left, right = _meet(left, right)
    values = function(_truth(left.values != 0), _truth(right.values != 0))
    return replace(_like(left if left.is_series else right, values, ""), condition=True)


def _plain(number: Any, unit: str = "") -> Quantity:
    return Quantity(np.asarray(number, dtype=np.float64), unit)


def _like(base: Quantity, values: Any, unit: str) -> Quantity:
    return Quantity(np.asarray(values, dtype=np.float64), unit, base.stamps_ns, base.seconds)


def _take(series: Quantity, rows: NDArray[np.intp]) -> Quantity:
    stamps, seconds = series.stamps_ns, series.seconds
    return replace(
        series,
        values=series.values[rows],
        stamps_ns=None if stamps is None else stamps[rows],
        seconds=None if seconds is None else seconds[rows],
    )


def _truth(held: Any) -> Array:
    return np.asarray(held, dtype=np.float64)


def _product(sign: str, left: str, right: str) -> str:
    left = "" if left == "1" else left
    right = "" if right == "1" else right
    if sign == "/" and left == right:
        return ""
    if not right:
        return left
    return f"{left or '1'}/{right}" if sign == "/" else f"{left}*{right}" if left else right
