"""From frames to columns: a block of frames, decoded message by message with array operations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.canbus.contract import Contract, MessageCodec, SignalSpec
from hil.canbus.frame import EXTENDED_ID_FLAG, Frame

__all__ = ["Block", "MessageBlock", "decode_block", "value_signals"]


@dataclass(frozen=True)
class MessageBlock:
    """All frames of one message in a block.

    `rows` (n) are their places in the block, `values` (n, signals) the DBC's physical values in the
    order of `codec.signals`, Crc and Counter included.
    """

    codec: MessageCodec
    rows: NDArray[np.intp]
    values: NDArray[np.float64]

    def column(self, signal: str) -> NDArray[np.float64]:
        """Values of one signal; ContractError when the message has none of that name."""
        return self.values[:, self.codec.signals.index(self.codec.signal(signal))]


@dataclass(frozen=True)
class Block:
    """Frames in the order of arrival. `unknown` and `malformed` count what the contract cannot decode.

    `unknown` is by identifier as in `Frame.can_id`, that is with EXTENDED_ID_FLAG if it has 29 bits.
    """

    stamps_ns: NDArray[np.int64]
    messages: Mapping[str, MessageBlock]
    unknown: Mapping[int, int]
    malformed: Mapping[str, int]

    def __len__(self) -> int:
        return len(self.stamps_ns)


def decode_block(frames: Sequence[Frame], contract: Contract) -> Block:
    """Decode frames; those with an identifier or a length that the contract does not have are counted."""
    if not frames:
        return Block(np.empty(0, np.int64), {}, {}, {})
    stamps, identifiers, payloads = zip(*frames, strict=True)
    ids = np.array(identifiers, dtype=np.int64)
    lengths = np.fromiter(map(len, payloads), np.int64, len(payloads))
    messages: dict[str, MessageBlock] = {}
    unknown: dict[int, int] = {}
    malformed: dict[str, int] = {}
    for identifier in np.unique(ids).tolist():
        rows = np.flatnonzero(ids == identifier)
        codec = contract.by_id.get(identifier & ~EXTENDED_ID_FLAG)
        # The 29-bit identifier 0x180 is another message than the 11-bit 0x180.
        if codec is None or codec.extended != (identifier >= EXTENDED_ID_FLAG):
            unknown[identifier] = len(rows)
            continue
        whole = rows[lengths[rows] == codec.length]
        if len(whole) < len(rows):
            malformed[codec.name] = len(rows) - len(whole)
        if len(whole):
            joined = b"".join([payloads[row] for row in whole])
            matrix = np.frombuffer(joined, np.uint8).reshape(len(whole), codec.length)
            messages[codec.name] = MessageBlock(codec, whole, codec.decode_columns(matrix))
    return Block(np.array(stamps, dtype=np.int64), messages, unknown, malformed)


def value_signals(codec: MessageCodec) -> tuple[SignalSpec, ...]:
    """The signals that carry values: all but Crc and Counter."""
    return tuple(signal for signal in codec.signals if signal.role == "NONE")
