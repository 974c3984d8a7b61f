"""Ask a recording for numbers: python examples/ask_a_recording.py [RUN].

Cells start with `# %%`: editors with a Python console (VS Code, PyCharm, Spyder) run them one by one.
Without RUN the newest of runs/ is taken; `hil run` makes one.
"""

# %% Open the run. Nothing is decoded before it is asked for.
import sys
from pathlib import Path

import numpy as np

from hil.record import open_run

arguments = [word for word in sys.argv[1:] if not word.startswith("-")]
runs = sorted(Path("runs").glob("*/run.rrd"), key=lambda file: file.stat().st_mtime)
if not arguments and not runs:
    sys.exit("no run there: `hil run` makes one, or name one: python examples/ask_a_recording.py RUN")
run = open_run(arguments[0] if arguments else runs[-1].parent)
print(run.path, run.properties.get("scenario", ""), run.summary.get("verdict", ""))

# %% What is in it.
for signal in run.signals:
    if signal.samples:
        print(f"{signal.name:45} {signal.unit:8} {signal.samples:7d}")

# %% One signal: every sample with its stamp.
speed = run["ODO_Motion.Speed"]
print(f"{len(speed)} samples, highest {speed.values.max():.2f} {speed.unit}")
print(f"first at {speed.bus_time_ns[0].astype('datetime64[ns]')} UTC, {speed.sim_time_s[0]:.3f} s")

# %% The plant's truth beside the measurement: on the stamps of the measurement, values held in between.
table = run.to_arrow(["ODO_Motion.Speed", "plant_sim.speed_mps"])
measured_mps = table["ODO_Motion.Speed"].to_numpy() / 3.6
error_mps = measured_mps - table["plant_sim.speed_mps"].to_numpy()
print(f"odometer against truth: rms {np.sqrt(np.nanmean(error_mps**2)):.4f} m/s")

# %% A state as words: how long the controller was in each mode.
mode = run["ATO_Status.Mode"]
lasted_s = np.diff(mode.sim_time_s, append=mode.sim_time_s[-1])
for word in dict.fromkeys(mode.names()):
    total_s = sum(time for time, name in zip(lasted_s, mode.names(), strict=True) if name == word)
    print(f"{word:20} {total_s:6.1f} s")

# %% Timing of every cycle.
cycles = run.cycles("controller")
latency_us = cycles["wakeup_latency_us"].to_numpy()
print(f"{cycles.num_rows} cycles, wake-up latency p99 {np.percentile(latency_us, 99):.0f} us")

# %% The frames as they were on the bus.
identifiers = [frame.arbitration_id for frame in run.frames]
print(f"{len(identifiers)} frames, {len(set(identifiers))} identifiers")
