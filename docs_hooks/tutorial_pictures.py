"""Draws the pictures of the tutorial from its runs: python docs_hooks/tutorial_pictures.py RUNS [FOLDER].

RUNS holds the runs of the tutorial under the names that it gives them: smc, sign, killed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from hil.record import open_run

BLUE, ORANGE, GREY = "#1f77b4", "#d95f02", "#666666"


def law_picture(runs: Path, png: Path) -> None:
    """Effort demand of the sliding mode with its boundary layer, and with the sign that its paper prints."""
    figure, axes = plt.subplots(2, 1, figsize=(9, 4.6), sharex=True, sharey=True, layout="constrained")
    for axis, name, title, colour in (
        (axes[0], "smc", "boundary layer of 0.12 m/s", BLUE),
        (axes[1], "sign", "sign: boundary layer 0", ORANGE),
    ):
        demand = open_run(runs / name)["ATO_Command.EffortDemand"]
        axis.plot(demand.sim_time_s, demand.values, color=colour, linewidth=0.8)
        axis.set_title(title, loc="left", fontsize=10)
        axis.set_ylabel("effort demand, %")
        axis.grid(alpha=0.3)
    axes[1].set_xlabel("time, s")
    _save(figure, png)


def killed_picture(runs: Path, png: Path) -> None:
    """Speed and efforts around the moment in which the controller is killed."""
    run = open_run(runs / "killed")
    last = run["ATO_Command.EffortDemand"].sim_time_s[-1]
    figure, axes = plt.subplots(3, 1, figsize=(9, 6), sharex=True, layout="constrained")
    speed = run["plant_sim.speed_mps"]
    axes[0].plot(speed.sim_time_s, speed.values * 3.6, color=BLUE)
    axes[0].set_ylabel("speed, km/h")
    age = run["plant_sim.command_age_ms"]
    axes[1].plot(age.sim_time_s, age.values, color=GREY)
    axes[1].axhline(50.0, color=ORANGE, linestyle="--", linewidth=1)
    axes[1].set_ylabel("age of the command, ms")
    axes[1].set_ylim(0, 300)
    for name, colour in (("traction", BLUE), ("electrodynamic", ORANGE), ("pneumatic", GREY)):
        effort = run[f"plant_sim.{name}_effort_n"]
        axes[2].plot(effort.sim_time_s, effort.values / 1e3, color=colour, label=name)
    axes[2].set_ylabel("effort, kN")
    axes[2].set_xlabel("time, s")
    axes[2].legend(loc="upper left", fontsize=8)
    for axis in axes:
        axis.axvline(last, color="black", linewidth=0.8)
        axis.grid(alpha=0.3)
    axes[0].annotate("controller killed", (last, speed.values.max() * 3.6 * 0.3), xytext=(6, 0),
                     textcoords="offset points")  # fmt: skip
    axes[2].set_xlim(last - 5.0, float(speed.sim_time_s[-1]))
    _save(figure, png)


def _save(figure: Figure, png: Path) -> None:
    figure.savefig(png, dpi=110)
    plt.close(figure)


def main() -> None:
    """Draw both."""
    runs = Path(sys.argv[1])
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).parent.parent / "docs" / "pictures"
    law_picture(runs, folder / "tutorial-law.png")
    killed_picture(runs, folder / "tutorial-killed.png")


if __name__ == "__main__":
    main()
