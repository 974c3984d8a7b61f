"""`hil doctor --fix-vcan` on machines of all kinds: what it runs, what it says, how it ends."""

import json
import subprocess
import sys
from dataclasses import dataclass, field

import pytest

from hil.canbus.options import is_can_interface_up
from hil.cli.doctor_vcan import BadChannel, ThisMachine, repair

MODPROBE = "modprobe -a can-raw can-bcm vcan"
ADD, UP = "ip link add dev vcan0 type vcan", "ip link set up vcan0"


@dataclass
class Machine:
    """A machine that does what its kernel can."""

    root: bool = True
    can: bool = True
    vcan: bool = True
    modprobe: bool = True
    interfaces: dict = field(default_factory=dict)  # name: (type, is up, is real)
    ran: list = field(default_factory=list)

    def is_root(self):
        return self.root

    def has_can(self):
        return self.can

    def kind(self, channel):
        return self.interfaces.get(channel, (None,))[0]

    def is_real(self, channel):
        return self.interfaces.get(channel, (0, 0, False))[2]

    def is_up(self, channel):
        kind, up, _ = self.interfaces.get(channel, (None, False, False))
        return kind == 280 and up

    def run(self, command):
        assert self.root
        line = " ".join(command)
        self.ran.append(line)
        if command[0] == "modprobe":
            return "" if self.modprobe else "modprobe: FATAL: Module vcan not found"
        if command[2] == "add":
            if not (self.can and self.vcan):
                return "Error: Unknown device type."
            self.interfaces[command[4]] = (280, False, False)
            return ""
        kind, _, real = self.interfaces[command[4]]
        self.interfaces[command[4]] = (kind, True, real)
        return ""


def test_root_brings_it_up():
    machine = Machine()
    done = repair("vcan0", machine)
    assert done.up
    assert machine.ran == [MODPROBE, ADD, UP]
    assert [step.state for step in done.steps] == ["done"] * 3
    assert done.remedy == ""


def test_interface_that_is_there_is_only_set_up_and_one_that_is_up_is_left_alone():
    machine = Machine(interfaces={"vcan0": (280, False, False)})
    assert repair("vcan0", machine).up
    assert machine.ran == [MODPROBE, UP]
    machine.ran.clear()
    assert repair("vcan0", machine).steps == ()
    assert machine.ran == []


def test_kernel_with_vcan_built_in_needs_no_modprobe():
    done = repair("vcan0", Machine(modprobe=False))
    assert done.up
    assert [step.state for step in done.steps] == ["failed", "done", "done"]


def test_without_root_nothing_is_run_and_the_commands_are_told():
    machine = Machine(root=False)
    done = repair("vcan0", machine)
    assert not done.up
    assert [str(step) for step in done.steps] == [MODPROBE, ADD, UP]
    assert {step.state for step in done.steps} == {"needed"}
    assert "sudo hil doctor --fix-vcan --channel vcan0" in done.remedy


def test_kernel_without_can_says_where_to_get_one_and_what_does_without():
    done = repair("vcan0", Machine(can=False, modprobe=False))
    assert not done.up
    assert [step.state for step in done.steps] == ["failed", "failed"]
    assert done.steps[-1].detail == "Error: Unknown device type."
    for way in ("no SocketCAN", "linux-modules-extra-", "make test-vcan", "hil run -i hil"):
        assert way in done.remedy
    assert "\n" not in done.remedy


def test_kernel_with_can_but_without_vcan_is_another_case():
    remedy = repair("vcan0", Machine(vcan=False, modprobe=False)).remedy
    assert "but no vcan" in remedy
    assert "NET_ADMIN" in remedy


def test_real_adapter_is_not_touched():
    machine = Machine(interfaces={"can0": (280, False, True)})
    assert "type can bitrate 500000" in repair("can0", machine).remedy
    assert machine.ran == []


@pytest.mark.parametrize("channel", ["", "-x", "a b", "vcan0; reboot", "../x", "name-of-16-chars"])
def test_name_that_cannot_be_an_interface_is_bad_input(channel):
    with pytest.raises(BadChannel) as caught:
        repair(channel, Machine())
    assert caught.value.exit_code == 2


def test_other_interface_of_that_name_is_bad_input():
    with pytest.raises(BadChannel, match="no CAN interface"):
        repair("eth0", Machine(interfaces={"eth0": (1, True, True)}))


@pytest.mark.parametrize(
    ("answer", "complaint"),
    [
        (subprocess.CompletedProcess([], 0, "", ""), ""),
        (subprocess.CompletedProcess([], 1, "", "Error:\n no.\n"), "Error: no."),
        (subprocess.CompletedProcess([], 7, "", ""), "exit code 7"),
        (FileNotFoundError("no such program"), "no such program"),
        (subprocess.TimeoutExpired("modprobe", 30), "timed out"),
    ],
)
def test_complaint_of_a_command_is_one_line(answer, complaint):
    def run(*_, **__):
        if isinstance(answer, Exception):
            raise answer
        return answer

    told = ThisMachine(run).run(["modprobe", "vcan"])
    assert complaint in told if complaint else told == ""
    assert "\n" not in told


def test_command_line_says_in_json_and_exit_code_what_became_of_it(tmp_path):
    """As the user without root: nothing on this machine is changed."""
    if is_can_interface_up("vcan7"):
        pytest.skip("vcan7 is up here")
    program = (
        "import os, sys; os.geteuid = lambda: 1000; from hil.cli import main;"
        "sys.exit(main(['doctor', '--fix-vcan', '--channel', 'vcan7', *sys.argv[1:]]))"
    )
    as_json, plain = (
        subprocess.run([sys.executable, "-c", program, *more], capture_output=True, text=True, cwd=tmp_path)
        for more in (["--json"], [])
    )
    document = json.loads(as_json.stdout)
    assert (as_json.returncode, plain.returncode) == (3, 3)
    assert document["up"] is False
    assert [step["state"] for step in document["steps"]] == ["needed"] * len(document["steps"])
    assert "sudo ip link set up vcan7" in plain.stdout.splitlines()
    assert plain.stderr.startswith("hil doctor: vcan7 is not up: run it as root")
