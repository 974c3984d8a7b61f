"""The machinery itself: which kernel is chosen, and that a guest that says nothing is a failure."""

import os
import subprocess
import sys
from types import SimpleNamespace

import guest_kernel
import pytest
from guest_kernel import Guest, NoKernel, allow_mappings, choose, kernel_image, on_cpu


def available(**reasons):
    return {kind: (lambda reason=reason: reason) for kind, reason in reasons.items()}


def test_first_kernel_that_nothing_speaks_against_is_chosen():
    assert choose("", available(native="", uml="", qemu="")) == "native"
    assert choose("", available(native="no vcan0", uml="", qemu="")) == "uml"
    assert choose("", available(native="no vcan0", uml="not installed", qemu="")) == "qemu"


def test_named_kernel_is_taken_or_refused_never_replaced():
    assert choose("uml", available(native="", uml="", qemu="")) == "uml"
    with pytest.raises(NoKernel, match="uml: not installed"):
        choose("uml", available(native="", uml="not installed", qemu=""))
    with pytest.raises(NoKernel, match="one of native, uml, qemu"):
        choose("xen", available(native="", uml="", qemu=""))


def test_no_kernel_at_all_tells_every_reason():
    with pytest.raises(NoKernel, match="native: no vcan0; uml: not installed"):
        choose("", available(native="no vcan0", uml="not installed"))


def test_kernel_image_without_vcan_is_passed_over(tmp_path, monkeypatch):
    monkeypatch.setenv("HIL_VCAN_KERNEL_IMAGE", str(tmp_path))
    (tmp_path / "boot").mkdir()
    for version in ("6.1.0-1-cloud-amd64", "6.1.0-1-amd64"):
        (tmp_path / "boot" / f"vmlinuz-{version}").touch()
        (tmp_path / "lib/modules" / version).mkdir(parents=True)
    vcan = tmp_path / "lib/modules/6.1.0-1-amd64/kernel/vcan.ko.xz"
    vcan.parent.mkdir()
    vcan.touch()
    assert kernel_image() == (tmp_path / "boot/vmlinuz-6.1.0-1-amd64", tmp_path / "lib/modules/6.1.0-1-amd64")


@pytest.mark.skipif(sys.platform != "linux", reason="CPU affinity as Linux has it")
def test_child_inherits_one_cpu_and_we_keep_ours():
    ours = os.sched_getaffinity(0)
    with on_cpu(max(ours)):
        child = subprocess.run(
            [sys.executable, "-c", "import os; print(os.sched_getaffinity(0))"],
            capture_output=True,
            text=True,
        )
    assert child.stdout.strip() == str({max(ours)})
    assert os.sched_getaffinity(0) == ours


def test_guest_that_dies_without_a_word_fails_every_test_that_it_should_have_run(
    tmp_path, request, monkeypatch
):
    (plugin,) = (
        plugin
        for plugin in request.config.pluginmanager.get_plugins()
        if getattr(plugin, "__file__", "") == str(guest_kernel.GUEST.parent / "conftest.py")
    )
    item = SimpleNamespace(
        nodeid="tests/vcan/test_socketcan.py::test_x",
        location=("tests/vcan/test_socketcan.py", 1, "test_x"),
        path=guest_kernel.GUEST.parent / "test_socketcan.py",
    )
    guests = plugin.Guests("uml", [item], request.config)
    guests.folder = tmp_path
    (tmp_path / "console.log").write_text("Kernel panic - not syncing")

    def dead(*_):
        return Guest(subprocess.Popen(["false"]), tmp_path)

    monkeypatch.setattr(guests, "_boot", dead)
    (report,) = guests.reports_of(item)
    assert report.failed
    assert "Kernel panic" in report.longrepr


def test_host_is_asked_for_more_mappings_only_where_it_has_fewer(tmp_path, monkeypatch):
    limit = tmp_path / "max_map_count"
    monkeypatch.setattr(guest_kernel, "MAX_MAP_COUNT", limit)
    assert allow_mappings() is None  # no such limit
    limit.write_text("65530\n")
    assert allow_mappings() == 65_530
    assert int(limit.read_text()) == 262_144
    limit.write_text("1048576\n")
    assert allow_mappings() is None
    assert int(limit.read_text()) == 1_048_576
