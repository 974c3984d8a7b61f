"""The wheel carries its data: installed elsewhere, `hil run` works from any folder."""

import json
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.timeout(300)
def test_installed_wheel_runs_from_any_folder(tmp_path):
    subprocess.run(
        [
            sys.executable,
            "-m",
            "build",
            "--wheel",
            "--no-isolation",
            "--outdir",
            str(tmp_path / "dist"),
            str(ROOT),
        ],
        check=True,
        capture_output=True,
    )
    wheel = next((tmp_path / "dist").glob("*.whl"))
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "venv")], check=True)
    python = tmp_path / "venv/bin/python"
    site = tmp_path / f"venv/lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages"
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(site), str(wheel)],
        check=True,
    )
    # The dependencies are those of this environment; its editable install is not seen through a .pth file.
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    where = subprocess.run(
        [str(python), "-c", "import hil, dbc; print(hil.__file__, dbc.path())"],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert str(ROOT) not in where.stdout
    done = subprocess.run(
        [
            str(python),
            "-m",
            "hil",
            "run",
            "--lockstep",
            "-i",
            "virtual",
            "-c",
            "wheel",
            "--json",
            "--out",
            "mine",
        ],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["verdict"] == "passed"
    assert (folder / "mine/run.rrd").exists()
