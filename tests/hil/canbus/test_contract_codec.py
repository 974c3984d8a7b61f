"""Encode and decode equal cantools, on the shipped contract and on random messages."""

from __future__ import annotations

import math
import random
import tempfile
from fractions import Fraction
from pathlib import Path

import cantools
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import dbc
from hil.canbus.contract import Contract, DecodeError, EncodeError
from hil.canbus.units import SI_UNITS

CONTRACT = Contract.load()
ORACLE = cantools.database.load_file(dbc.path(), database_format="dbc", strict=True)
CODECS = [pytest.param(codec, id=codec.name) for codec in CONTRACT.messages.values()]


def exact_si(signal, raw):
    """Value in SI by exact arithmetic on the decimal numbers of the file."""
    physical = raw * Fraction(repr(signal.scale)) + Fraction(repr(signal.offset))
    return physical * SI_UNITS[signal.unit][1]


def exact_raw(signal, value):
    """Raw value before rounding, by exact arithmetic."""
    physical = Fraction(value) / SI_UNITS[signal.unit][1]
    return (physical - Fraction(repr(signal.offset))) / Fraction(repr(signal.scale))


def near_a_tie(signal, value):
    """Whether rounding to a step may go either way by the last digit of a float."""
    raw = exact_raw(signal, value)
    return abs(raw - math.floor(raw) - Fraction(1, 2)) < Fraction(1, 10**6)


def oracle_physical(message, data):
    return message.decode(data, decode_choices=False, scaling=True)


def agree_on_frames(codec, message, payloads):
    """Decode and decode_columns of each payload equal cantools'; encoding the values gives the bits back."""
    columns = codec.decode_columns(np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, codec.length))
    assert columns.shape == (len(payloads), len(codec.signals))
    ones = {s.name: -1 if s.signed else (1 << s.length_bits) - 1 for s in codec.value_signals}
    protection = {s.name: 0 for s in codec.signals if s.role != "NONE"}
    used = message.encode(ones | protection, scaling=False, strict=False)
    for data, row in zip(payloads, columns, strict=True):
        raw = message.decode(data, decode_choices=False, scaling=False)
        physical = oracle_physical(message, data)
        values = codec.decode(data)
        assert list(values) == [signal.name for signal in codec.value_signals]
        for signal, cell in zip(codec.signals, row, strict=True):
            # within one rounding of cantools' two
            assert cell == pytest.approx(
                float(physical[signal.name]), rel=1e-14, abs=1e-14 * abs(signal.offset)
            )
            if signal.role != "NONE":
                continue
            value = values[signal.name]
            assert value == float(exact_si(signal, raw[signal.name])) or signal.integer
            if signal.integer:
                assert type(value) is int
                assert value == raw[signal.name] == physical[signal.name]
        # above 48 bits a float no longer holds every step
        inside = all(s.raw_limits[0] <= raw[s.name] <= s.raw_limits[1] for s in codec.value_signals)
        exact = all(s.integer or s.length_bits <= 48 for s in codec.value_signals)
        if inside and exact:
            expected = bytes(byte & mask for byte, mask in zip(data, used, strict=True))
            assert codec.encode(values) == expected


def agree_on_values(codec, message, rng, count):
    """Encoding random physical values, limits included, equals cantools."""
    for _ in range(count):
        physical = {}
        for signal in codec.value_signals:
            low, high = (limit * signal.scale + signal.offset for limit in signal.raw_limits)
            kind = rng.random()
            value = low if kind < 0.15 else high if kind < 0.3 else rng.uniform(low, high)
            physical[signal.name] = round(value) if signal.integer else value
        values = {
            s.name: physical[s.name] if s.integer else physical[s.name] * s.si_factor
            for s in codec.value_signals
        }
        if any(near_a_tie(signal, values[signal.name]) for signal in codec.value_signals):
            continue
        protection = {signal.name: 0 for signal in codec.signals if signal.role != "NONE"}
        assert codec.encode(values) == message.encode(physical | protection, strict=False)


# --- the shipped contract --------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", CODECS)
def test_random_frames_decode_as_in_cantools(codec):
    rng = random.Random(codec.name)
    payloads = [bytes(codec.length), b"\xff" * codec.length] + [
        rng.randbytes(codec.length) for _ in range(200)
    ]
    agree_on_frames(codec, ORACLE.get_message_by_name(codec.name), payloads)


@pytest.mark.parametrize("codec", CODECS)
def test_random_values_encode_as_in_cantools(codec):
    agree_on_values(codec, ORACLE.get_message_by_name(codec.name), random.Random(codec.name), 200)


@pytest.mark.parametrize("codec", CODECS)
def test_start_values_are_those_of_the_file(codec):
    message = ORACLE.get_message_by_name(codec.name)
    start = {signal.name: signal.raw_initial for signal in message.signals}
    expected = message.encode(start | {s.name: 0 for s in codec.signals if s.role != "NONE"}, scaling=False)
    assert codec.encode({}) == expected
    assert codec.encode(codec.start_values) == expected
    assert codec.decode(bytes(expected)) == codec.start_values


SIGNALS = [
    pytest.param(codec, signal, id=f"{codec.name}.{signal.name}")
    for codec in CONTRACT.messages.values()
    for signal in codec.value_signals
]


@pytest.mark.parametrize(("codec", "signal"), SIGNALS)
def test_range_is_inclusive_and_not_more(codec, signal):
    step = exact_si(signal, 1) - exact_si(signal, 0)
    for limit, outward in zip(signal.si_limits, (-step, step), strict=True):
        assert codec.decode(codec.encode({signal.name: limit}))[signal.name] == limit
        almost = float(Fraction(limit) + outward * Fraction(49, 100))
        assert codec.encode({signal.name: almost}) == codec.encode({signal.name: limit})
        beyond = float(Fraction(limit) + outward)
        with pytest.raises(
            EncodeError, match=rf"^{codec.name}\.{signal.name}: .* is (above|below) the m"
        ) as caught:
            codec.encode({signal.name: beyond})
        assert "\n" not in str(caught.value)
        assert codec.encode(codec.saturated({signal.name: beyond})) == codec.encode({signal.name: limit})


@pytest.mark.parametrize(("codec", "signal"), SIGNALS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float64("nan")])
def test_what_is_not_finite_is_refused(codec, signal, value):
    with pytest.raises(EncodeError, match=rf"^{codec.name}\.{signal.name}: .*not a finite number"):
        codec.encode({signal.name: value})


# --- one message in detail -------------------------------------------------------------------------------


def test_values_are_si():
    motion = CONTRACT.message("ODO_Motion")
    data = ORACLE.encode_message("ODO_Motion", {
        "Crc": 0, "Counter": 0, "Valid": 1, "Standstill": 0, "Slip": 0, "Slide": 0,
        "Speed": 72.0, "Position": 1234567,
    })  # fmt: skip
    values = motion.decode(data)
    assert values == {"Valid": 1, "Standstill": 0, "Slip": 0, "Slide": 0, "Speed": 20.0, "Position": 1234.567}
    status = CONTRACT.message("TCU_Status")
    values = status.decode(status.encode({"TractiveEffort": -123_460.0, "CommandAge": 0.042, "State": 3}))
    assert (values["TractiveEffort"], values["CommandAge"], values["State"]) == (-123_460.0, 0.042, 3)
    command = CONTRACT.message("ATO_Command")
    assert command.decode(command.encode({"EffortDemand": -0.25}))["EffortDemand"] == -0.25
    timing = CONTRACT.message("ATO_Timing")
    assert timing.decode(timing.encode({"WorstSignalAge": 0.0123}))["WorstSignalAge"] == 0.0123


def test_error_names_message_signal_value_limit_and_unit():
    cases = {
        ("ATO_Command", "EffortDemand", 1.2): "ATO_Command.EffortDemand: 120 % is above the maximum 100 %",
        ("TCU_Status", "TractiveEffort", -1e6): (
            "TCU_Status.TractiveEffort: -1000 kN (-1000000 N) is below the minimum -655.36 kN"
        ),
        ("ATO_Command", "Mode", 9): "ATO_Command.Mode: 9 is above the maximum 6",
        ("ATO_Command", "Mode", "RUN"): "ATO_Command.Mode: 'RUN' is not a number",
        ("ATO_Command", "Crc", 1): "ATO_Command.Crc: is written by the E2E protection, it cannot be set",
        ("SYNC", "Tock", 1): "SYNC: no signal 'Tock'; it has Tick",
    }
    for (message, signal, value), text in cases.items():
        with pytest.raises(EncodeError) as caught:
            CONTRACT.message(message).encode({signal: value})
        assert str(caught.value) == text


def test_unknown_name_is_refused_also_when_the_number_of_values_is_right():
    command = CONTRACT.message("ATO_Command")
    values = dict(command.start_values)
    values["Effort"] = values.pop("EffortDemand")
    with pytest.raises(EncodeError, match="no signal 'Effort'"):
        command.encode(values)
    with pytest.raises(EncodeError, match="no signal 'Effort'"):
        command.saturated({"Effort": 1.0})


@pytest.mark.parametrize(
    "one", [True, 1, 1.0, np.True_, np.int64(1), np.uint8(1), np.float32(1), Fraction(1)]
)
def test_any_kind_of_number_is_taken(one):
    motion = CONTRACT.message("ODO_Motion")
    assert motion.encode({"Valid": one, "Position": one}) == motion.encode({"Valid": 1, "Position": 1.0})


def test_crc_and_counter_are_left_to_the_protection():
    for codec in CONTRACT.messages.values():
        if codec.protection:
            data = codec.encode({name: codec.signal(name).si_limits[1] for name in codec.start_values})
            assert data[0] == 0
            assert data[1] & 0x0F == 0
            assert isinstance(data, bytearray)


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("wrong", [-1, 1])
def test_wrong_length_is_refused(codec, wrong):
    with pytest.raises(DecodeError, match=rf"^{codec.name}: payload has {codec.length + wrong} bytes"):
        codec.decode(bytes(codec.length + wrong))
    with pytest.raises(DecodeError, match=f"^{codec.name}: payloads are uint8"):
        codec.decode_columns(np.zeros((3, codec.length + wrong), np.uint8))


@pytest.mark.parametrize("payloads", [np.zeros(8, np.uint8), np.zeros((2, 8), np.int8), np.zeros((2, 8))])
def test_columns_of_another_shape_or_type_are_refused(payloads):
    with pytest.raises(DecodeError, match="needed are uint8"):
        CONTRACT.message("ODO_Motion").decode_columns(payloads)


def test_columns_take_no_frames_and_views_and_leave_them_alone():
    motion = CONTRACT.message("ODO_Motion")
    assert motion.decode_columns(np.empty((0, 8), np.uint8)).shape == (0, 8)
    block = np.random.default_rng(1).integers(0, 256, (50, 24), dtype=np.uint8)
    before = block.copy()
    view = block[::2, 8:16]
    columns = motion.decode_columns(view)
    np.testing.assert_array_equal(columns, motion.decode_columns(np.ascontiguousarray(view)))
    np.testing.assert_array_equal(block, before)
    assert columns[:, 0].flags.c_contiguous


# --- random messages -------------------------------------------------------------------------------------

SCALES = ["1", "0.01", "0.02", "0.5", "2", "3", "0.001", "0.1", "0.0078125", "0.3", "-1", "-0.25", "1E-005"]
OFFSETS = ["0", "0", "0", "1", "-40", "0.5", "1000", "-0.125"]
UNITS = ["", "", "km/h", "mm", "kN", "%", "ms", "us", "m/s^2", "rounds"]


@st.composite
def random_message(draw):
    """DBC text of one message with non-overlapping signals of both byte orders, and its length."""
    length = draw(st.sampled_from([1, 2, 3, 5, 6, 7, 8, 8, 8, 12, 16, 20, 24, 32, 48, 64]))
    free = set(range(8 * length))
    lines = []
    for number in range(draw(st.integers(1, 12))):
        bits = draw(st.integers(1, min(64, 8 * length)))
        first = draw(st.integers(0, 8 * length - bits))
        big = draw(st.booleans())
        taken = set(range(first, first + bits))
        start = first
        if big:  # counted from the left; a DBC names the highest bit
            taken = {8 * (p // 8) + 7 - p % 8 for p in taken}
            start = 8 * (first // 8) + 7 - first % 8
        if not taken <= free:
            continue
        free -= taken
        sign = draw(st.sampled_from("+-"))
        scale, offset, unit = (draw(st.sampled_from(choice)) for choice in (SCALES, OFFSETS, UNITS))
        unit = unit.replace("rounds", "")
        scaling = f'({scale},{offset}) [0|0] "{unit}"'
        lines.append(f" SG_ S{number} : {start}|{bits}@{0 if big else 1}{sign} {scaling} Vector__XXX")
    return f'VERSION ""\n\nBU_: N\n\nBO_ 256 Random: {length} N\n' + "\n".join(lines) + "\n\n"


@pytest.fixture(scope="module")
def scratch():
    with tempfile.TemporaryDirectory() as directory:
        yield Path(directory) / "random.dbc"


@given(random_message(), st.integers(0, 2**32))
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_message_of_any_dbc_equals_cantools(scratch, text, seed):
    rng = random.Random(seed)
    scratch.write_text(text)
    codec = Contract.load(scratch).message("Random")
    message = cantools.database.load_string(text, database_format="dbc").get_message_by_name("Random")
    payloads = [bytes(codec.length), b"\xff" * codec.length, *(rng.randbytes(codec.length) for _ in range(6))]
    agree_on_frames(codec, message, payloads)
    if all(signal.length_bits <= 40 for signal in codec.signals):
        agree_on_values(codec, message, rng, 5)


@pytest.mark.parametrize("order", ["little", "big"])
def test_signal_is_found_at_every_position_of_a_long_payload(scratch, order):
    length, bits = 17, 17
    text = 'VERSION ""\n\nBU_: N\n\n'
    for first in range(8 * length - bits + 1):
        start = first if order == "little" else 8 * (first // 8) + 7 - first % 8
        text += f"BO_ {first + 1} M{first}: {length} N\n"
        text += f' SG_ S : {start}|{bits}@{1 if order == "little" else 0}+ (1,0) [0|0] "" N\n\n'
    scratch.write_text(text)
    contract = Contract.load(scratch)
    data = random.Random(1).randbytes(length)
    whole = int.from_bytes(data, order)
    for first in range(8 * length - bits + 1):
        shift = first if order == "little" else 8 * length - bits - first
        expected = whole >> shift & (1 << bits) - 1
        codec = contract.message(f"M{first}")
        assert codec.decode(data) == {"S": expected}
        assert codec.decode_columns(np.frombuffer(data, np.uint8)[None, :]) == [[expected]]
        assert codec.encode({"S": expected}) == (expected << shift).to_bytes(length, order)


def test_64_bits_survive_whole(scratch):
    scratch.write_text(
        'VERSION ""\n\nBU_: N\n\nBO_ 256 Wide: 24 N\n'
        ' SG_ Unsigned : 3|64@1+ (1,0) [0|0] "" N\n SG_ Signed : 90|64@0- (1,0) [0|0] "" N\n\n'
    )
    codec = Contract.load(scratch).message("Wide")
    for unsigned, signed in [(2**64 - 1, -(2**63)), (2**63 + 1, 2**63 - 1), (0, -1)]:
        data = codec.encode({"Unsigned": unsigned, "Signed": signed})
        assert codec.decode(data) == {"Unsigned": unsigned, "Signed": signed}
        columns = codec.decode_columns(np.frombuffer(bytes(data), np.uint8)[None, :])
        assert columns[0].tolist() == [float(unsigned), float(signed)]
    with pytest.raises(EncodeError, match="above the maximum"):
        codec.encode({"Unsigned": 2**64})
