"""SocketCAN's bytes: frames against python-can's, ancillary data as the kernel lays it out."""

import socket
import struct
import sys

import can
import pytest
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame
from can.interfaces.socketcan.utils import pack_filters as their_filters
from hypothesis import example, given
from hypothesis import strategies as st

from hil.canbus.frame import EXTENDED_ID_FLAG
from hil.canbus.socketcan_wire import SO_RXQ_OVFL, SO_TIMESTAMPNS, pack_filters, pack_frame, parse_control

IDENTIFIERS = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED_ID_FLAG))
CLASSIC = st.binary(max_size=8)
FD = st.integers(9, 64).flatmap(lambda size: st.binary(min_size=size, max_size=size))


def message(can_id, data, **more):
    return can.Message(
        arbitration_id=can_id & 0x1FFFFFFF, is_extended_id=bool(can_id & EXTENDED_ID_FLAG), data=data, **more
    )


@given(can_id=IDENTIFIERS, data=CLASSIC)
def test_classic_frame_is_what_python_can_builds(can_id, data):
    packed = pack_frame(can_id, data)
    theirs = bytearray(build_can_frame(message(can_id, data)))
    theirs[7] = 0  # python-can repeats the length in len8_dlc, which the kernel takes as 0 up to 8
    assert packed == bytes(theirs)
    assert len(packed) == 16


@given(can_id=IDENTIFIERS, data=FD, switch=st.booleans())
@example(can_id=1, data=bytes(9), switch=True)
def test_fd_frame_is_read_by_python_can_with_zeros_up_to_the_next_length(can_id, data, switch):
    packed = pack_frame(can_id, data, bit_rate_switch=switch)
    read_id, length, flags, read = dissect_can_frame(packed)
    assert len(packed) == 72
    assert read_id == can_id
    assert flags == 0x04 | (0x01 if switch else 0)
    assert length in (12, 16, 20, 24, 32, 48, 64)
    assert read == data.ljust(length, b"\0")
    padded = message(can_id, data.ljust(length, b"\0"), is_fd=True, bitrate_switch=switch)
    theirs = bytearray(build_can_frame(padded))
    theirs[7] = 0
    assert packed == bytes(theirs)


def test_identifier_above_11_bits_is_extended_without_its_flag():
    assert pack_frame(0x800, b"") == pack_frame(0x800 | EXTENDED_ID_FLAG, b"")


def test_too_long_data_are_refused():
    with pytest.raises(ValueError, match="0x123: 65 data bytes; 64 at most"):
        pack_frame(0x123, bytes(65))


@given(st.frozensets(IDENTIFIERS, min_size=1, max_size=20))
def test_filters_are_python_cans_and_leave_out_remote_frames(wanted):
    theirs = [
        {"can_id": i & 0x1FFFFFFF, "can_mask": 0x1FFFFFFF if i & EXTENDED_ID_FLAG else 0x7FF,
         "extended": bool(i & EXTENDED_ID_FLAG)}
        for i in sorted(wanted)
    ]  # fmt: skip
    ours = struct.unpack(f"={2 * len(wanted)}I", pack_filters(wanted))
    expected = struct.unpack(f"={2 * len(wanted)}I", their_filters(theirs))
    remote = 0x4000_0000
    assert ours[::2] == expected[::2]
    assert list(ours[1::2]) == [mask | remote for mask in expected[1::2]]


def item(level, kind, content):
    """A struct cmsghdr with its content, filled up as CMSG_SPACE says."""
    whole = struct.pack("@Nii", struct.calcsize("@Nii") + len(content), level, kind) + content
    word = struct.calcsize("@N")
    return whole.ljust(-(-len(whole) // word) * word, b"\0")


@given(
    seconds=st.integers(0, 2**31 - 1),
    nanoseconds=st.integers(0, 999_999_999),
    drops=st.integers(0, 2**32 - 1),
)
def test_stamp_and_drop_counter_are_read_in_any_order_beside_others(seconds, nanoseconds, drops):
    stamp = item(1, SO_TIMESTAMPNS, struct.pack("@ll", seconds, nanoseconds))
    counter = item(1, SO_RXQ_OVFL, struct.pack("=I", drops))
    other = item(101, 7, b"abc")
    expected = (seconds * 1_000_000_000 + nanoseconds, drops)
    assert parse_control(stamp + counter) == expected
    assert parse_control(other + counter + other + stamp) == expected
    assert parse_control(stamp) == (expected[0], 0)
    assert parse_control(counter) == (0, drops)


@given(st.binary(max_size=64))
def test_any_bytes_end_the_parsing(control):
    stamp_ns, drops = parse_control(control)
    assert isinstance(stamp_ns, int)
    assert 0 <= drops < 2**32


def test_known_bytes_of_a_64_bit_little_endian_kernel():
    if sys.byteorder != "little" or struct.calcsize("@N") != 8:
        pytest.skip("another byte order")
    control = bytes.fromhex(
        "2000000000000000 01000000 23000000 00ca9a6500000000 15cd5b0700000000"
        "1400000000000000 01000000 28000000 881300000000 0000"
    )
    assert parse_control(control) == (0x659ACA00 * 1_000_000_000 + 123_456_789, 5000)


@pytest.mark.skipif(not hasattr(socket, "CMSG_SPACE"), reason="no ancillary data here")
def test_ancillary_data_fit_where_they_are_read_to():
    from hil.canbus.socketcan_reader import _CONTROL_SIZE

    assert socket.CMSG_SPACE(struct.calcsize("@ll")) + socket.CMSG_SPACE(4) <= _CONTROL_SIZE
