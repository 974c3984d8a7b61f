"""Encode and decode of one odometer frame: the contract's compiled codec beside cantools."""

from __future__ import annotations

import cantools

import dbc
from benchmarks.rows import Row, in_turns_us
from hil.canbus.contract import Contract


def measure() -> list[Row]:
    ours = Contract.load().message("ODO_Motion")
    peer = cantools.database.load_file(dbc.path()).get_message_by_name("ODO_Motion")
    values = {"Speed": 12.5, "Position": 431.25, "Valid": 1}
    zeros = {signal.name: 0 for signal in peer.signals}
    theirs = {**zeros, "Speed": 45.0, "Position": 431250, "Valid": 1}
    data = bytes(ours.encode(values))
    encode = in_turns_us(lambda: ours.encode(values), lambda: peer.encode(theirs))
    decode = in_turns_us(lambda: ours.decode(data), lambda: peer.decode(data, decode_choices=False))
    return [
        Row("encode ODO_Motion, range-checked", *encode, "us", "cantools encode, strict"),
        Row("decode ODO_Motion", *decode, "us", "cantools decode, no choices"),
    ]
