"""What a bus message is made of: signals, their scaling to SI, protection; and what can be wrong with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

from hil.canbus.units import si_unit


class ContractError(ValueError):
    """The bus contract is missing, unreadable or lacks something; names file, message and signal."""

    exit_code = 2


class EncodeError(ValueError):
    """A value does not fit its signal; names message, signal, value and limit."""

    exit_code = 2


class DecodeError(ValueError):
    """A payload does not fit its message; names message and lengths."""

    exit_code = 2


@dataclass(frozen=True)
class ProtectionSpec:
    """How a message is protected: AUTOSAR E2E profile, data ID and the widest counter step still accepted."""

    profile: str
    data_id: int
    max_delta_counter: int

    def __post_init__(self) -> None:
        if self.profile != "P01":
            raise ContractError(f"E2E profile {self.profile!r} is not supported; use P01 or NONE")
        if not 0 <= self.data_id <= 0xFFFF:
            raise ContractError(f"E2EDataID {self.data_id} is outside 0 to 65535")
        if not 1 <= self.max_delta_counter <= 14:
            raise ContractError(f"E2EMaxDeltaCounter {self.max_delta_counter} is outside 1 to 14")


@dataclass(frozen=True)
class SignalSpec:
    """One signal as the DBC describes it.

    `minimum`, `maximum`, `scale` and `offset` are in the DBC's unit: physical = raw x scale + offset, and
    SI = physical x `si_factor`. `start` is in SI. `start_bit` is counted as in the DBC file. `role` is NONE,
    or CRC or COUNTER for the two signals that the E2E protection writes.
    """

    name: str
    unit: str
    si_unit: str
    si_factor: float
    scale: float
    offset: float
    start_bit: int
    length_bits: int
    signed: bool
    minimum: float
    maximum: float
    choices: Mapping[int, str]
    start: float
    comment: str
    big_endian: bool = False
    role: str = "NONE"

    @property
    def integer(self) -> bool:
        """True for a flag, an enumeration or a count (no unit, no scaling): such a signal decodes to int."""
        return self.unit == "" and self.scale == 1 and self.offset == 0

    @cached_property
    def raw_limits(self) -> tuple[int, int]:
        """Smallest and largest raw value that is inside [minimum, maximum] and fits the bits."""
        scale, offset = _decimal(self.scale), _decimal(self.offset)
        ends = sorted((_decimal(end) - offset) / scale for end in (self.minimum, self.maximum))
        lowest = -(1 << (self.length_bits - 1)) if self.signed else 0
        highest = lowest + (1 << self.length_bits) - 1
        return max(math.ceil(ends[0]), lowest), min(math.floor(ends[1]), highest)

    @cached_property
    def si_limits(self) -> tuple[float, float]:
        """Smallest and largest value in SI."""
        low, high = (self.si_scaling.value(raw) for raw in self.raw_limits)
        return min(low, high), max(low, high)

    @cached_property
    def si_scaling(self) -> Scaling:
        """Raw value <-> value in SI."""
        factor = si_unit(self.unit)[1]
        return Scaling.of(_decimal(self.scale) * factor, _decimal(self.offset) * factor)

    @cached_property
    def physical_scaling(self) -> Scaling:
        """Raw value <-> value in the DBC's unit."""
        return Scaling.of(_decimal(self.scale), _decimal(self.offset))

    def out_of_range(self, number: float) -> str:
        """Say in one line that a value in SI is outside the range: value, limit and unit."""
        physical = number / self.si_factor
        side, limit = "below the minimum", self.minimum
        if physical > self.maximum:
            side, limit = "above the maximum", self.maximum
        given = f"{physical:.10g} {self.unit}".rstrip()
        if self.si_unit not in (self.unit, "1"):
            given += f" ({number:.10g} {self.si_unit})"
        return f"{given} is {side} {limit:.10g} {self.unit}".rstrip()


class Scaling(NamedTuple):
    """value = (raw x factor + shift) / divisor, in integers.

    So the division is the only rounding: a step of 0.01 km/h is raw / 360 in m/s, exact to the last digit.
    """

    factor: int
    shift: int
    divisor: int

    @classmethod
    def of(cls, scale: Fraction, offset: Fraction) -> Scaling:
        """The integers for value = raw x scale + offset."""
        divisor = math.lcm(scale.denominator, offset.denominator)
        return cls(int(scale * divisor), int(offset * divisor), divisor)

    def value(self, raw: int) -> float:
        """Value of a raw number."""
        return (raw * self.factor + self.shift) / self.divisor

    def value_source(self, raw: str) -> str:
        """Python source of `value`; `raw` is the source of an integer."""
        scaled = raw if self.factor == 1 else f"{raw} * {self.factor}"
        shifted = f"({scaled} + {self.shift})" if self.shift else scaled
        return f"{shifted} / {self.divisor}"

    def raw_source(self, value: str) -> str:
        """Python source of the raw number, not yet rounded; `value` is the source of a number."""
        source = value if self.divisor == 1 else f"{value} * {float(self.divisor)!r}"
        if self.shift:
            source = f"({source} - {float(self.shift)!r})"
        return source if self.factor == 1 else f"{source} / {float(self.factor)!r}"


def _decimal(number: float) -> Fraction:
    """The decimal number that was written in the file: 0.01 means 1/100, not the float nearest to it."""
    return Fraction(repr(number))
