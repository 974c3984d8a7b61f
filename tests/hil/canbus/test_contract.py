"""The contract: what a DBC file gives, and what is said about one that will not do."""

from __future__ import annotations

import pytest

import dbc
from hil.canbus.contract import Contract, ContractError, ProtectionSpec

HEAD = 'VERSION ""\n\nBU_: A B\n\n'
GOOD = ' SG_ Speed : 0|16@1- (0.01,0) [-300|300] "km/h" B\n'
PROTECTED = ' SG_ Crc : 0|8@1+ (1,0) [0|255] "" B\n SG_ Counter : 8|4@1+ (1,0) [0|14] "" B\n'
DEFINITIONS = """
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "TimeoutMs" INT 0 65535;
BA_DEF_ BO_ "E2EProfile" ENUM "NONE","P01","P02";
BA_DEF_ BO_ "E2EDataID" INT 0 65535;
BA_DEF_ BO_ "E2EMaxDeltaCounter" INT 0 255;
BA_DEF_ SG_ "GenSigStartValue" INT -2147483648 2147483647;
BA_DEF_ SG_ "E2ERole" ENUM "NONE","CRC","COUNTER";
BA_DEF_DEF_ "GenMsgCycleTime" 20;
BA_DEF_DEF_ "TimeoutMs" 70;
BA_DEF_DEF_ "E2EProfile" "NONE";
BA_DEF_DEF_ "E2EDataID" 0;
BA_DEF_DEF_ "E2EMaxDeltaCounter" 3;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_DEF_DEF_ "E2ERole" "NONE";
"""
ROLES = 'BA_ "E2ERole" SG_ 256 Crc 1;\nBA_ "E2ERole" SG_ 256 Counter 2;\n'
P01 = 'BA_ "E2EProfile" BO_ 256 1;\nBA_ "E2EDataID" BO_ 256 4660;\n'


@pytest.fixture
def load(tmp_path):
    def load(text, encoding="utf-8"):
        path = tmp_path / "mine.dbc"
        path.write_bytes(text.encode(encoding))
        return Contract.load(path)

    return load


def message(signals, tail=""):
    return f"{HEAD}BO_ 256 M: 8 A\n{signals}\n{tail}\n"


def error_of(call, *arguments):
    with pytest.raises(ContractError) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2
    return str(caught.value)


# --- the shipped file ------------------------------------------------------------------------------------


def test_default_is_the_shipped_contract():
    contract = Contract.load()
    assert contract.path == dbc.path()
    assert contract.nodes == ("ATO", "TCU", "BCU", "ODO", "ATP", "BENCH")
    command = contract.message("ATO_Command")
    assert contract.by_id[command.can_id] is command is contract.messages["ATO_Command"]
    assert (command.can_id, command.length, command.sender) == (0x181, 6, "ATO")
    assert command.receivers == ("TCU", "BCU", "ATP", "BENCH")
    assert (command.cycle_ns, command.timeout_ns, command.send_type) == (10_000_000, 50_000_000, "cyclic")
    assert command.protection == ProtectionSpec("P01", 0xA181, 3)
    assert "TCU cuts traction" in command.comment


def test_signal_carries_all_that_the_file_says():
    speed = Contract.load().message("ODO_Motion").signal("Speed")
    assert (speed.unit, speed.si_unit, speed.scale, speed.offset) == ("km/h", "m/s", 0.01, 0)
    assert speed.si_factor == pytest.approx(1 / 3.6)
    assert (speed.start_bit, speed.length_bits, speed.signed) == (16, 16, True)
    assert (speed.minimum, speed.maximum) == (-327.68, 327.67)
    assert speed.comment.startswith("Measured speed")
    assert Contract.load().message("ATO_Command").signal("Mode").choices[2] == "RUN"


def test_event_message_has_neither_cycle_nor_silence_limit():
    balise = Contract.load().message("ODO_Balise")
    assert (balise.cycle_ns, balise.timeout_ns, balise.send_type) == (None, None, "event")
    assert balise.protection is not None


def test_sent_by_a_node():
    contract = Contract.load()
    assert [codec.name for codec in contract.sent_by("ODO")] == ["ODO_Motion", "ODO_Balise", "ODO_Heartbeat"]
    assert error_of(contract.sent_by, "ECU") == (
        "ato_bench.dbc: no node 'ECU'; it has ATO, TCU, BCU, ODO, ATP, BENCH"
    )


def test_missing_message_is_named_with_the_file():
    contract = Contract.load()
    assert error_of(contract.message, "X").startswith(
        "ato_bench.dbc: no message 'X'; it has SYNC, ATO_Emergency,"
    )
    assert error_of(contract.require, ["SYNC", "X", "Y"]).startswith(
        "ato_bench.dbc: no messages 'X', 'Y'; it has"
    )
    contract.require(contract.messages)
    assert "no signal 'X'; it has Tick" in error_of(contract.message("SYNC").signal, "X")


# --- a file that will not do -----------------------------------------------------------------------------


def test_missing_file_is_named(tmp_path):
    assert error_of(Contract.load, tmp_path / "no.dbc") == f"{tmp_path / 'no.dbc'}: no such DBC file"
    assert "cannot be read" in error_of(Contract.load, tmp_path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('VERSION ""\n\nBO_ nonsense\n', "line 3"),
        ("<html></html>", "line 1"),
        (message(GOOD + ' SG_ Other : 8|16@1+ (1,0) [0|0] "" B\n'), "overlapping"),
        (message(' SG_ Wide : 60|16@1+ (1,0) [0|0] "" B\n'), "does not fit"),
        (message(GOOD, 'BA_ "Undefined" BO_ 256 1;'), "Undefined"),
    ],
)
def test_file_that_is_no_valid_dbc_is_named_with_the_reason(load, text, reason):
    text = error_of(load, text)
    assert text.startswith("mine.dbc: not a valid DBC file: ")
    assert reason in text


def test_same_name_or_identifier_twice_is_an_error(load):
    twice = message(GOOD) + f"BO_ 257 M: 8 A\n{GOOD}\n"
    assert error_of(load, twice) == "mine.dbc: message M is defined twice"
    twice = message(GOOD) + f"BO_ 256 N: 8 A\n{GOOD}\n"
    assert error_of(load, twice) == "mine.dbc: M and N have the same identifier 0x100"


UNSUPPORTED = {
    "multiplexed": (
        ' SG_ Page m0 : 8|8@1+ (1,0) [0|0] "" B\n SG_ Which M : 0|8@1+ (1,0) [0|0] "" B\n',
        "",
        "mine.dbc: M: multiplexed messages are not supported",
    ),
    "float": (
        ' SG_ Real : 0|32@1- (1,0) [0|0] "" B\n',
        "SIG_VALTYPE_ 256 Real : 1;",
        "mine.dbc: M.Real: floating-point signals are not supported",
    ),
    "unit": (
        ' SG_ Speed : 0|16@1- (1,0) [0|0] "furlong" B\n',
        "",
        "mine.dbc: M.Speed: unit 'furlong' is not known; use one of '1', '%', ",
    ),
    "empty range": (
        ' SG_ Speed : 0|8@1+ (1,0) [300|400] "km/h" B\n',
        "",
        "mine.dbc: M.Speed: no value fits its range [300|400] km/h",
    ),
    "start": (
        ' SG_ Speed : 0|8@1+ (1,0) [0|200] "km/h" B\n',
        f'{DEFINITIONS}BA_ "GenSigStartValue" SG_ 256 Speed 201;',
        "mine.dbc: M.Speed: raw start value 201 is outside 0 to 200",
    ),
    "profile": (
        PROTECTED,
        f'{DEFINITIONS}{ROLES}BA_ "E2EProfile" BO_ 256 2;',
        "mine.dbc: M: E2E profile 'P02' is not supported; use P01 or NONE",
    ),
    "delta": (
        PROTECTED,
        f'{DEFINITIONS}{ROLES}{P01}BA_ "E2EMaxDeltaCounter" BO_ 256 15;',
        "mine.dbc: M: E2EMaxDeltaCounter 15 is outside 1 to 14",
    ),
    "role without profile": (
        PROTECTED,
        f"{DEFINITIONS}{ROLES}",
        "mine.dbc: M: has E2ERole COUNTER, CRC, but E2EProfile is NONE",
    ),
    "profile without role": (
        PROTECTED,
        f'{DEFINITIONS}{P01}BA_ "E2ERole" SG_ 256 Crc 1;',
        "mine.dbc: M: E2EProfile is P01, but no signal has E2ERole COUNTER",
    ),
    "geometry": (
        PROTECTED.replace("8|4@1+", "12|4@1+"),
        f"{DEFINITIONS}{ROLES}{P01}",
        "mine.dbc: M.Counter: as E2E COUNTER it must be 8|4@1+ (1,0), no unit",
    ),
}


@pytest.mark.parametrize("case", UNSUPPORTED)
def test_message_that_cannot_be_carried_is_an_error_for_those_who_need_it(load, case):
    signals, tail, reason = UNSUPPORTED[case]
    contract = load(
        message(signals, tail) + f"BO_ 257 Good: 8 A\n{GOOD}\n" if not tail else message(signals, tail)
    )
    assert list(contract.unsupported) == ["M"]
    assert error_of(contract.message, "M").startswith(reason)
    assert error_of(contract.require, ["M"]).startswith(reason)
    assert 0x100 not in contract.by_id
    if not tail:
        assert contract.message("Good").signal("Speed").unit == "km/h"


@pytest.mark.parametrize(
    "counter", ["8|3@1+ (1,0)", "8|4@1- (1,0)", "12|4@1+ (1,0)", "11|4@0+ (1,0)", "8|4@1+ (2,0)"]
)
def test_counter_of_another_geometry_is_refused(load, counter):
    signals = PROTECTED.replace("8|4@1+ (1,0)", counter).replace("[0|14]", "[0|0]")
    contract = load(message(signals, DEFINITIONS + ROLES + P01))
    assert "M.Counter: as E2E COUNTER it must be 8|4@1+ (1,0)" in error_of(contract.message, "M")


def test_29_bit_identifier_is_told_from_an_11_bit_one(load):
    contract = load(message(GOOD).replace("BO_ 256", f"BO_ {0x8000_0000 | 0x1234}"))
    assert (contract.message("M").can_id, contract.message("M").extended) == (0x1234, True)
    contract = load(message(GOOD).replace("BO_ 256", f"BO_ {0x8000_0000 | 0x123}"))
    assert "29-bit identifier 0x123 is not supported" in error_of(contract.message, "M")


# --- a file of somebody else -----------------------------------------------------------------------------


def test_file_without_our_attributes_is_unprotected_and_without_limits(load):
    codec = load(message(GOOD)).message("M")
    assert (codec.protection, codec.cycle_ns, codec.timeout_ns, codec.send_type) == (
        None,
        None,
        None,
        "event",
    )


def test_attribute_defaults_of_the_file_count(load):
    codec = load(message(GOOD, DEFINITIONS)).message("M")
    assert (codec.cycle_ns, codec.timeout_ns, codec.send_type) == (20_000_000, 70_000_000, "cyclic")
    codec = load(message(PROTECTED, DEFINITIONS + ROLES + P01)).message("M")
    assert codec.protection == ProtectionSpec("P01", 4660, 3)


def test_range_wider_than_the_bits_ends_at_the_bits(load):
    speed = load(message(' SG_ Speed : 0|8@1+ (0.5,0) [0|500] "km/h" B\n')).message("M").signal("Speed")
    assert speed.raw_limits == (0, 255)


def test_start_value_is_the_nearest_to_zero_where_none_is_given(load):
    codec = load(message(' SG_ Speed : 0|8@1+ (1,0) [36|72] "km/h" B\n')).message("M")
    assert codec.start_values == {"Speed": 10.0}


def test_message_without_signals_is_a_message(load):
    codec = load(message("")).message("M")
    assert codec.encode({}) == bytes(8)
    assert codec.decode(bytes(8)) == {}


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
def test_units_outside_ascii_are_read_in_both_usual_encodings(load, encoding):
    signals = ' SG_ T : 0|16@1+ (1,0) [0|0] "µs" B\n SG_ A : 16|16@1+ (1,0) [0|0] "m/s²" B\n'
    codec = load(message(signals), encoding).message("M")
    assert codec.decode(bytes([7, 0, 3, 0, 0, 0, 0, 0])) == {"T": 7e-6, "A": 3.0}


def test_node_that_nobody_named_is_no_sender(load):
    codec = load(message(GOOD).replace("8 A", "8 Vector__XXX")).message("M")
    assert codec.sender == ""
