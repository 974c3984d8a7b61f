"""The bus contract: a DBC file as typed messages in SI; the only source of identifiers, cycles and scaling.

Every message is a `MessageCodec`. What the bench cannot carry (multiplexed or floating-point signals, unknown
units) is kept in `Contract.unsupported` with its reason, and is an error as soon as somebody asks for that
message: a DBC of a whole vehicle may hold messages that no node here needs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cantools.database
from cantools.database.can import Message, Signal

import dbc
from hil.canbus.codec import MAX_SIGNAL_BITS, MessageCodec
from hil.canbus.signals import ContractError, DecodeError, EncodeError, ProtectionSpec, SignalSpec
from hil.canbus.units import SI_UNITS, si_unit

__all__ = [
    "Contract",
    "ContractError",
    "DecodeError",
    "EncodeError",
    "MessageCodec",
    "ProtectionSpec",
    "SignalSpec",
]

NS_PER_MS = 1_000_000
NOBODY = "Vector__XXX"  # how a DBC says "no node"


@dataclass(frozen=True)
class Contract:
    """All messages of one DBC file, by name and by identifier; `unsupported`: those left out, and why."""

    path: Path
    messages: Mapping[str, MessageCodec]
    by_id: Mapping[int, MessageCodec]
    nodes: tuple[str, ...]
    unsupported: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path | None = None) -> Contract:
        """Read a DBC file; default: the shipped ato_bench.dbc.

        ContractError: missing, unreadable, not a DBC, or two messages of one name or identifier.
        """
        path = Path(dbc.path() if path is None else path)
        database = read_database(path)
        nodes = tuple(node.name for node in database.nodes)
        messages: dict[str, MessageCodec] = {}
        unsupported: dict[str, str] = {}
        by_id: dict[int, MessageCodec] = {}
        for message in database.messages:
            if message.name in messages or message.name in unsupported:
                raise ContractError(f"{path.name}: message {message.name} is defined twice")
            try:
                codec = _message(message, nodes)
            except ContractError as error:
                unsupported[message.name] = f"{path.name}: {error}"
                continue
            if codec.can_id in by_id:
                both = f"{by_id[codec.can_id].name} and {codec.name}"
                raise ContractError(f"{path.name}: {both} have the same identifier 0x{codec.can_id:03X}")
            messages[codec.name] = by_id[codec.can_id] = codec
        return cls(
            path, MappingProxyType(messages), MappingProxyType(by_id), nodes, MappingProxyType(unsupported)
        )

    def message(self, name: str) -> MessageCodec:
        """The message of that name; ContractError lists what there is."""
        self.require([name])
        return self.messages[name]

    def sent_by(self, node: str) -> tuple[MessageCodec, ...]:
        """The messages that a node sends; ContractError if the file has no such node."""
        if node not in self.nodes:
            raise ContractError(
                f"{self.path.name}: no node {node!r}; it has {', '.join(self.nodes) or 'none'}"
            )
        return tuple(codec for codec in self.messages.values() if codec.sender == node)

    def require(self, names: Iterable[str]) -> None:
        """ContractError unless every one of these messages is there and can be carried."""
        lacking = [name for name in names if name not in self.messages]
        for name in lacking:
            if name in self.unsupported:
                raise ContractError(self.unsupported[name])
        if lacking:
            wanted = f"message{'s' if len(lacking) > 1 else ''} {', '.join(map(repr, lacking))}"
            raise ContractError(f"{self.path.name}: no {wanted}; it has {', '.join(self.messages) or 'none'}")


def read_database(path: Path) -> cantools.database.Database:
    """A DBC file as cantools reads it. ContractError: missing, unreadable, or not a DBC of a CAN bus."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ContractError(f"{path}: no such DBC file") from None
    except OSError as error:
        raise ContractError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")  # what DBC editors write
    try:
        database = cantools.database.load_string(text, database_format="dbc", strict=True)
    except (
        Exception
    ) as error:  # a parser of files from outside: it also ends in KeyError, IndexError and others
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ContractError(f"{path.name}: not a valid DBC file: {reason}") from None
    if not isinstance(database, cantools.database.Database):
        raise ContractError(f"{path.name}: describes diagnostics, not a CAN bus")
    return database


def _message(message: Message, nodes: tuple[str, ...]) -> MessageCodec:
    if message.is_multiplexed():
        raise ContractError(f"{message.name}: multiplexed messages are not supported")
    if message.is_extended_frame and message.frame_id <= 0x7FF:
        raise ContractError(
            f"{message.name}: the 29-bit identifier 0x{message.frame_id:X} is not supported (below 0x800)"
        )
    sender = next((name for name in message.senders if name != NOBODY), "")
    cycle_ms, timeout_ms = message.cycle_time or 0, message_attribute(message, "TimeoutMs", 0)
    signals = tuple(_signal(message, signal) for signal in message.signals)
    return MessageCodec(
        name=message.name,
        can_id=message.frame_id,
        length=message.length,
        sender=sender,
        receivers=tuple(node for node in nodes if node in message.receivers),
        cycle_ns=int(cycle_ms * NS_PER_MS) or None,
        timeout_ns=int(timeout_ms * NS_PER_MS) or None,
        send_type=message.send_type or ("cyclic" if cycle_ms else "event"),
        protection=_protection(message, signals),
        signals=signals,
        comment=message.comment or "",
        extended=message.is_extended_frame,
    )


def _signal(message: Message, signal: Signal) -> SignalSpec:
    where = f"{message.name}.{signal.name}"
    unit = (signal.unit or "").strip()
    if signal.conversion.is_float:
        raise ContractError(f"{where}: floating-point signals are not supported")
    if signal.length > MAX_SIGNAL_BITS:
        raise ContractError(f"{where}: {signal.length} bits are not supported, at most {MAX_SIGNAL_BITS}")
    if not math.isfinite(signal.scale) or signal.scale == 0:
        raise ContractError(f"{where}: the factor {signal.scale} makes no sense")
    try:
        si, factor = si_unit(unit)
    except KeyError:
        known = ", ".join(repr(known) for known in SI_UNITS if known)
        raise ContractError(f"{where}: unit {unit!r} is not known; use one of {known}") from None
    minimum, maximum = _range(signal)
    spec = SignalSpec(
        name=signal.name,
        unit=unit,
        si_unit=si,
        si_factor=float(factor),
        scale=signal.scale,
        offset=signal.offset,
        start_bit=signal.start,
        length_bits=signal.length,
        signed=signal.is_signed,
        minimum=minimum,
        maximum=maximum,
        choices=MappingProxyType({int(raw): str(text) for raw, text in (signal.choices or {}).items()}),
        start=0,
        comment=signal.comment or "",
        big_endian=signal.byte_order == "big_endian",
        role=message_attribute(signal, "E2ERole", "NONE"),
    )
    low, high = spec.raw_limits
    if low > high:
        raise ContractError(
            f"{where}: no value fits its range [{signal.minimum}|{signal.maximum}] {unit}".rstrip()
        )
    raw_start = min(max(0, low), high) if signal.raw_initial is None else signal.raw_initial
    if not low <= raw_start <= high or raw_start != int(raw_start):
        raise ContractError(f"{where}: raw start value {raw_start} is outside {low} to {high}")
    start = int(raw_start) if spec.integer else spec.si_scaling.value(int(raw_start))
    return replace(spec, start=start)


def _range(signal: Signal) -> tuple[float, float]:
    """The range given in the file; where there is none, what the bits can hold."""
    bits = (-(1 << (signal.length - 1)), (1 << (signal.length - 1)) - 1)
    if not signal.is_signed:
        bits = (0, (1 << signal.length) - 1)
    ends = sorted(raw * signal.scale + signal.offset for raw in bits)
    minimum = ends[0] if signal.minimum is None else signal.minimum
    maximum = ends[1] if signal.maximum is None else signal.maximum
    return minimum, maximum


def _protection(message: Message, signals: tuple[SignalSpec, ...]) -> ProtectionSpec | None:
    profile = message_attribute(message, "E2EProfile", "NONE")
    roles = {signal.role: signal for signal in signals if signal.role != "NONE"}
    if profile == "NONE":
        if roles:
            raise ContractError(
                f"{message.name}: has E2ERole {', '.join(sorted(roles))}, but E2EProfile is NONE"
            )
        return None
    try:
        data_id, max_delta = (
            message_attribute(message, "E2EDataID", 0),
            message_attribute(message, "E2EMaxDeltaCounter", 3),
        )
        protection = ProtectionSpec(profile, data_id, max_delta)
    except ContractError as error:
        raise ContractError(f"{message.name}: {error}") from None
    # AUTOSAR E2E profile 1, variant 1A: CRC in byte 0, counter in the low nibble of byte 1
    for role, start_bit, length in (("CRC", 0, 8), ("COUNTER", 8, 4)):
        signal = roles.get(role)
        if signal is None:
            raise ContractError(f"{message.name}: E2EProfile is {profile}, but no signal has E2ERole {role}")
        geometry = (signal.start_bit, signal.length_bits, signal.signed, signal.big_endian)
        if geometry != (start_bit, length, False, False) or not signal.integer:
            needed = f"{start_bit}|{length}@1+ (1,0), no unit"
            raise ContractError(f"{message.name}.{signal.name}: as E2E {role} it must be {needed}")
    return protection


def message_attribute(owner: Message | Signal, name: str, default: Any) -> Any:
    """Value of a DBC attribute, else its default in the file, else `default`; an enumeration as its text."""
    specifics = owner.dbc
    definitions = {} if specifics is None else specifics.attribute_definitions
    definition = definitions.get(name) if definitions else None
    if specifics is None or definition is None:
        return default
    if name not in specifics.attributes:
        return default if definition.default_value is None else definition.default_value
    value = specifics.attributes[name].value
    if definition.choices and isinstance(value, int):
        return definition.choices[value] if 0 <= value < len(definition.choices) else value
    return value
