"""Error frames of SocketCAN: against canerrsim's documented frame, the kernel's header and the local bus."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.error_frames import ERROR_FLAG, State, decode_error_frame, error_counters, state_after
from hil.canbus.local.confinement import Confinement

DATA = st.binary(min_size=0, max_size=8)


def test_frame_that_canerrsim_documents():
    """`canerrsim vcan0 LostArBit=09 Data4=AA TX BusOff NoAck`, as can-utils' canerrsim.c shows it."""
    frame = decode_error_frame(0x06A, bytes.fromhex("090080 00AA000000"))
    assert frame.classes == ("lost arbitration", "protocol violation", "no acknowledgement", "bus-off")
    assert frame.details == ("at bit 9", "on transmission")
    assert frame.is_bus_off
    assert (frame.tx_errors, frame.rx_errors) == (None, None)


@pytest.mark.parametrize(
    ("options", "can_id", "data", "classes", "details", "state"),
    [
        ("BusOff", 0x040, "", ["bus-off"], [], State.BUS_OFF),
        ("Restarted", 0x100, "", ["controller restarted"], [], State.ACTIVE),
        ("NoAck", 0x020, "", ["no acknowledgement"], [], None),
        ("TxTimeout", 0x001, "", ["transmit timeout"], [], None),
        ("WarningRX", 0x004, "0004", ["controller"], ["receive errors: warning"], State.WARNING),
        ("WarningTX", 0x004, "0008", ["controller"], ["transmit errors: warning"], State.WARNING),
        ("PassiveRX", 0x004, "0010", ["controller"], ["receive errors: passive"], State.PASSIVE),
        ("PassiveTX", 0x004, "0020", ["controller"], ["transmit errors: passive"], State.PASSIVE),
        ("Active", 0x004, "0040", ["controller"], ["error-active again"], State.ACTIVE),
        ("OverflowRX", 0x004, "0001", ["controller"], ["receive buffer overflow"], None),
        ("BitStuffing", 0x008, "000004", ["protocol violation"], ["bit stuffing"], None),
        ("ACK", 0x008, "00000019", ["protocol violation"], ["at acknowledge slot"], None),
        ("CanHiShortToGND", 0x010, "0000000007", ["transceiver"], ["CANH shorted to ground"], None),
        ("TxCount=60 RxCount=05", 0x200, "0000000000006005", ["error counters"], [], State.WARNING),
        ("TxCount=03 RxCount=80", 0x200, "0000000000000380", ["error counters"], [], State.PASSIVE),
    ],
)
def test_each_error_that_canerrsim_makes(options, can_id, data, classes, details, state):
    frame = decode_error_frame(ERROR_FLAG | can_id, bytes.fromhex(data))
    assert list(frame.classes) == classes, options
    assert list(frame.details) == details
    assert frame.state is state
    assert frame.is_bus_off == (state is State.BUS_OFF)


def test_counters_are_told_by_their_class_and_by_older_drivers_with_the_controller_class():
    counters = bytes.fromhex("0020000000008807")
    assert error_counters(0x200, counters) == (136, 7)
    assert error_counters(0x004, counters) == (136, 7)
    assert error_counters(0x004, bytes(8)) is None
    assert error_counters(0x080, counters) is None
    text = str(decode_error_frame(0x204, counters))
    assert (
        text == "controller, error counters (transmit errors: passive); 136 transmit errors, 7 receive errors"
    )


@given(can_id=st.integers(0, 0x1FFFFFFF), data=DATA)
def test_every_frame_can_be_decoded_and_printed(can_id, data):
    frame = decode_error_frame(can_id, data)
    assert "\n" not in str(frame)
    assert frame.state is state_after(can_id, data.ljust(8, b"\0"))
    assert bool(frame.classes) == bool(can_id & 0x3FF)


@given(
    st.lists(st.sampled_from(["transmit_failed", "receive_failed", "transmitted", "received"]), max_size=400)
)
def test_states_of_the_local_buss_controller_are_followed_exactly(events):
    """Another implementation writes the frames: the simulated controller of the local bus."""
    controller = Confinement()
    followed = State.ACTIVE
    for event in events:
        act = getattr(controller, event)
        notices = act(acknowledge=False) if event == "transmit_failed" else act()
        if event == "transmit_failed" and controller.state is State.BUS_OFF:
            notices += controller.recovered()
        for notice in notices:
            followed = state_after(notice.classes, notice.data) or followed
        assert followed is controller.state


def test_bits_and_locations_are_those_of_the_kernels_header():
    header = Path("/usr/include/linux/can/error.h")
    if not header.exists():
        pytest.skip("linux/can/error.h is not installed")
    defined = {
        name: int(value, 16)
        for name, value in re.findall(r"#define (CAN_ERR_\w+)\s+0x([0-9A-Fa-f]+)", header.read_text())
    }

    def said(can_id, at, value):
        data = bytearray(8)
        data[at] = value
        return " ".join(decode_error_frame(can_id, bytes(data)).details)

    words = {"SHORT_TO_GND": "shorted to ground", "SHORT_TO_BAT": "shorted to battery", "NO_WIRE": "broken"}
    words |= {"SHORT_TO_VCC": "shorted to supply", "SHORT_TO_CANH": "shorted to CANH"}
    for name, value in defined.items():
        if match := re.match(r"CAN_ERR_TRX_(CAN[HL])_(\w+)", name):
            assert said(0x10, 4, value) == f"{match[1]} {words[match[2]]}"
        elif match := re.match(r"CAN_ERR_PROT_LOC_ID(\d+)_(\d+)", name):
            assert said(0x08, 3, value) == f"at identifier bits {int(match[1])}-{int(match[2])}"
        elif match := re.match(r"CAN_ERR_CRTL_(RX|TX)_(WARNING|PASSIVE)", name):
            kind = {"RX": "receive", "TX": "transmit"}[match[1]]
            assert said(0x04, 1, value) == f"{kind} errors: {match[2].lower()}"
        elif name.startswith("CAN_ERR_PROT_LOC_") and value:
            assert "location" not in said(0x08, 3, value), name
    assert len(defined) > 50
