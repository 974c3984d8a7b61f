"""The hub's acceptance filter against python-can's own filter, and the records it selects from."""

from __future__ import annotations

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus.local.filters import INVERT, NOTHING, Acceptance, marked_own, pack_filters, select_records
from hil.canbus.local.wire import (
    CONTROL,
    ERROR,
    EXTENDED,
    FD,
    HEADER,
    MAX_CONTROL_LENGTH,
    OWN,
    REMOTE,
    Control,
    WireError,
    control_content,
    control_record,
)

identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF))
filters = st.lists(
    st.fixed_dictionaries(
        {"can_id": identifiers, "can_mask": st.one_of(identifiers, st.just(0x7FF))},
        optional={"extended": st.booleans()},
    ),
    min_size=1,
    max_size=4,
)


class SoftwareFiltered(can.BusABC):
    """A bus that filters as python-can does for interfaces that cannot."""

    def __init__(self, can_filters):
        super().__init__("none", can_filters)

    def send(self, msg, timeout=None):
        raise NotImplementedError


def record(can_id, data=b"", flags=0):
    return HEADER.pack(7, can_id, len(data), flags, len(data)) + data


@given(filters=filters, identifier=identifiers, extended=st.booleans(), remote=st.booleans())
def test_hub_filters_as_python_can_does(filters, identifier, extended, remote):
    if not extended:
        identifier &= 0x7FF
    bus = SoftwareFiltered(filters)
    message = can.Message(arbitration_id=identifier, is_extended_id=extended, is_remote_frame=remote)
    received_id = identifier | (EXTENDED if extended else 0) | (REMOTE if remote else 0)
    assert Acceptance(pack_filters(filters)).accepts(received_id) == bus._matches_filters(message)
    bus.shutdown()


@given(identifier=identifiers, mask=identifiers, received=identifiers)
def test_inverted_filter_takes_what_the_filter_leaves(identifier, mask, received):
    plain = Acceptance([(identifier, mask, None)])
    inverted = Acceptance([(identifier | INVERT, mask, None)])
    assert plain.accepts(received) != inverted.accepts(received)


@pytest.mark.parametrize("received", [0, 0x7FF, EXTENDED | 0x1FFFFFFF])
def test_filter_for_nothing_takes_no_data_frame(received):
    assert not Acceptance([NOTHING]).accepts(received)


def test_error_frames_pass_every_filter():
    assert Acceptance([NOTHING]).accepts(ERROR | 0x4)


def test_selection_keeps_whole_records_in_order():
    records = record(1, b"a") + record(2, bytes(8)) + record(1, bytes(64), FD) + record(3) + record(1, b"b")
    only_1 = Acceptance([(1, 0x7FF, False)])
    assert select_records(records, only_1, fd=True) == record(1, b"a") + record(1, bytes(64), FD) + record(
        1, b"b"
    )
    assert select_records(records, only_1, fd=False) == record(1, b"a") + record(1, b"b")
    assert select_records(records, None, fd=True) == records
    assert select_records(b"", None, fd=True) == b""


def test_own_frames_are_marked_in_a_copy():
    records = bytearray(record(1, b"abc") + record(2, bytes(64), FD))
    marked = marked_own(records)
    assert marked == record(1, b"abc", OWN) + record(2, bytes(64), FD | OWN)
    assert records == record(1, b"abc") + record(2, bytes(64), FD)


def test_control_record_round_trip():
    data = control_record(Control.HELLO, {"name": "ä", "filters": None})
    stamp, code, length, flags, _ = HEADER.unpack_from(data)
    assert (stamp, code, flags) == (0, Control.HELLO, CONTROL)
    assert control_content(data[HEADER.size :]) == {"name": "ä", "filters": None}
    assert len(data) == HEADER.size + length


@pytest.mark.parametrize("data", [b"", b"{", b"[1]", b"\xff"])
def test_control_record_without_an_object_is_refused(data):
    with pytest.raises(WireError):
        control_content(data)


def test_control_record_that_is_too_long_is_refused():
    with pytest.raises(WireError, match="limit"):
        control_record(Control.FILTERS, {"x": "y" * MAX_CONTROL_LENGTH})
