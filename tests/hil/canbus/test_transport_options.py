"""Which bus is chosen: command line over python-can's configuration over the default."""

from __future__ import annotations

import argparse
import json

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.canbus import options as module
from hil.canbus.transport import (
    BusOptions,
    BusOptionsError,
    BusUnavailable,
    add_bus_arguments,
    default_options,
    options_from_namespace,
)


def parsed(*arguments):
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_bus_arguments(parser)
    return options_from_namespace(parser.parse_args(arguments))


@pytest.fixture
def vcan0_is_up(monkeypatch):
    monkeypatch.setattr(module, "is_can_interface_up", lambda name: name == "vcan0")


@pytest.fixture
def no_vcan(monkeypatch):
    monkeypatch.setattr(module, "is_can_interface_up", lambda name: False)


@pytest.mark.usefixtures("no_vcan")
def test_default_is_the_local_bus():
    assert default_options() == parsed() == BusOptions("hil", "ato")


@pytest.mark.usefixtures("vcan0_is_up")
def test_default_is_vcan0_where_it_is_up():
    assert default_options() == parsed() == BusOptions("socketcan", "vcan0")


@pytest.mark.usefixtures("vcan0_is_up")
def test_named_channel_that_is_no_can_interface_is_on_the_local_bus():
    assert parsed("-c", "vcan0").interface == "socketcan"
    assert parsed("-c", "mine") == BusOptions("hil", "mine")


@pytest.mark.usefixtures("vcan0_is_up")
def test_environment_wins_over_the_default(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "there")
    monkeypatch.setenv("CAN_BITRATE", "250000")
    assert default_options() == BusOptions("virtual", "there", 250_000)


@pytest.mark.usefixtures("vcan0_is_up")
def test_can_conf_wins_over_the_default_and_loses_to_the_environment(monkeypatch, tmp_path):
    conf = tmp_path / "can.conf"
    conf.write_text("[default]\ninterface = hil\nchannel = from_file\nbitrate = 125000\n")
    monkeypatch.setattr("can.util.CONFIG_FILES", [str(conf)])
    assert default_options() == BusOptions("hil", "from_file", 125_000)
    monkeypatch.setenv("CAN_CHANNEL", "from_environment")
    assert default_options() == BusOptions("hil", "from_environment", 125_000)
    assert parsed("-c", "from_arguments") == BusOptions("hil", "from_arguments", 125_000)


@pytest.mark.usefixtures("no_vcan")
def test_can_rc_counts_as_configuration(monkeypatch):
    monkeypatch.setitem(can.rc, "interface", "virtual")
    assert default_options() == BusOptions("virtual", "ato")


def test_arguments_win_over_the_environment(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "socketcan")
    monkeypatch.setenv("CAN_CHANNEL", "can0")
    chosen = parsed("-i", "hil", "-c", "mine", "-b", "500000", "--fd", "--bus-kwargs", "autostart=False")
    assert chosen == BusOptions("hil", "mine", 500_000, True, {"autostart": False})


def test_interface_alone_gets_its_usual_channel():
    assert parsed("-i", "hil").channel == "ato"
    assert parsed("-i", "socketcan").channel == "vcan0"
    assert parsed("-i", "udp_multicast").channel == "239.74.163.2"


def test_numeric_channel_stays_text():
    assert parsed("-i", "hil", "-c", "7").channel == "7"


def test_interface_without_a_usual_channel_needs_one():
    with pytest.raises(BusOptionsError, match="interface 'pcan' needs a channel: -c CHANNEL") as caught:
        parsed("-i", "pcan")
    assert caught.value.exit_code == 2


def test_unknown_interface_in_the_configuration_is_unavailable(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "nosuch")
    with pytest.raises(
        BusUnavailable, match=r'Unknown interface type "nosuch"; python-can has: .*hil'
    ) as caught:
        default_options()
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("bitrate", ["0", "-5"])
def test_impossible_bit_rate_is_a_wrong_option(bitrate):
    with pytest.raises(BusOptionsError, match=f"bitrate {bitrate} must be a whole number of bit/s above 0"):
        parsed("-i", "hil", "-b", bitrate)


@pytest.mark.parametrize("text", ["{", "[1]", '"x"'])
def test_broken_configuration_is_a_wrong_option(monkeypatch, text):
    monkeypatch.setenv("CAN_CONFIG", text)
    with pytest.raises(BusOptionsError, match="CAN_CONFIG"):
        default_options()


def test_further_configuration_reaches_the_interface(monkeypatch):
    monkeypatch.setenv("CAN_INTERFACE", "udp_multicast")
    monkeypatch.setenv("CAN_CONFIG", json.dumps({"hop_limit": 0}))
    assert default_options().extra == {"hop_limit": 0}


names = st.from_regex(r"[a-z_][a-z0-9_]{0,8}", fullmatch=True).filter(
    lambda name: name not in {"interface", "channel", "bitrate", "fd", "port", "state", "timing", "bustype"}
)
values = st.one_of(
    st.booleans(),
    st.integers(-5, 10**9),
    st.from_regex(r"[a-z/][a-z0-9/:._-]{0,12}", fullmatch=True).filter(
        lambda text: text not in {"true", "false", "yes", "no", "on", "off", "inf", "nan", "infinity"}
    ),
)


@given(
    interface=st.sampled_from(["hil", "virtual", "socketcan"]),
    channel=st.from_regex(r"[a-z][a-z0-9.-]{0,8}", fullmatch=True),
    bitrate=st.one_of(st.none(), st.integers(1, 8_000_000)),
    fd=st.booleans(),
    data_bitrate=st.one_of(st.none(), st.integers(1, 8_000_000)),
    extra=st.dictionaries(names, values, max_size=3),
)
def test_arguments_for_a_child_name_the_same_bus(interface, channel, bitrate, fd, data_bitrate, extra):
    if data_bitrate is not None:
        extra = extra | {"data_bitrate": data_bitrate}
    options = BusOptions(interface, channel, bitrate, fd, extra)
    assert parsed(*options.to_arguments()) == options


def test_bit_timing_survives_the_way_to_a_child():
    timing = ["f_clock=8000000", "brp=1", "tseg1=13", "tseg2=2", "sjw=1", "nof_samples=1"]
    options = parsed("-i", "socketcan", "-c", "can0", "--timing", *timing)
    assert parsed(*options.to_arguments()) == options


@pytest.mark.parametrize("value", ["a b", object(), [1]])
def test_option_that_a_command_line_cannot_carry_is_refused(value):
    with pytest.raises(BusOptionsError, match=r"bus option key=.* cannot be handed to another process"):
        BusOptions("hil", "x", extra={"key": value}).to_arguments()


def test_no_can_interface_is_up_without_a_can_kernel(monkeypatch):
    def refuse(*_):
        raise OSError(97, "Address family not supported by protocol")

    monkeypatch.setattr("socket.socket", refuse)
    assert not module.has_socketcan()
    assert not module.is_can_interface_up("vcan0")
