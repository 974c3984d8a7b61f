"""A bit rate that a SocketCAN interface does not have is refused; what cannot be known is let through."""

from __future__ import annotations

import json
import os

import pytest

from hil.canbus.errors import BusOptionsError
from hil.canbus.options import BusOptions
from hil.canbus.socketcan_rate import check_bitrate, interface_bitrate

CAN0 = [  # what `ip -json -details link show dev can0` prints, iproute2 6.1, shortened
    {
        "ifname": "can0",
        "linkinfo": {
            "info_kind": "can",
            "info_data": {
                "state": "ERROR-ACTIVE",
                "restart_ms": 100,
                "bittiming": {"bitrate": 250000, "sample_point": "0.875", "tq": 250},
                "clock": 8000000,
            },
        },
    }
]
VCAN0 = [{"ifname": "vcan0", "linkinfo": {"info_kind": "vcan"}}]

pytestmark = pytest.mark.skipif(os.name == "nt", reason="puts a shell script in the place of ip: needs POSIX")


@pytest.fixture
def ip_says(tmp_path, monkeypatch):
    """Puts a program `ip` first that prints this for any interface."""

    def say(text, code=0):
        (tmp_path / "answer").write_text(text)
        program = tmp_path / "ip"
        program.write_text(f'#!/bin/sh\nread -r line < /dev/null\nwhile read -r line; do echo "$line"; done'
                           f' < "{tmp_path}/answer"\nexit {code}\n')  # fmt: skip
        program.chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path))

    return say


def test_another_bit_rate_than_the_interfaces_is_refused_with_both(ip_says):
    ip_says(json.dumps(CAN0) + "\n")
    with pytest.raises(BusOptionsError, match=r"-b 500000: can0 runs at 250000 bit/s.*bitrate 500000"):
        check_bitrate(BusOptions("socketcan", "can0", 500000))


def test_the_interfaces_own_bit_rate_is_taken(ip_says):
    ip_says(json.dumps(CAN0) + "\n")
    assert interface_bitrate("can0") == 250000
    check_bitrate(BusOptions("socketcan", "can0", 250000))


@pytest.mark.parametrize(
    ("text", "code"), [(json.dumps(VCAN0), 0), ("", 1), ("not json", 0), ("[]", 0), ('[{"linkinfo": 3}]', 0)]
)
def test_what_is_not_known_is_let_through(ip_says, text, code):
    ip_says(text + "\n", code)
    assert interface_bitrate("vcan0") is None
    check_bitrate(BusOptions("socketcan", "vcan0", 500000))


def test_without_iproute2_nothing_is_known(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert interface_bitrate("can0") is None


def test_other_interfaces_are_not_asked(ip_says):
    ip_says(json.dumps(CAN0) + "\n")
    check_bitrate(BusOptions("hil", "can0", 500000))
    check_bitrate(BusOptions("socketcan", "can0"))
