"""What controller, plant and bench may all know of the railway: lines, trains, resistances, journeys.

Pure and frozen, SI inside. Files are TOML; see `line_file`, `train_file` and `journey` for the keys.
"""

from hil.railway.errors import RailwayDataError
from hil.railway.journey import Journey, load_journey, scenario_table
from hil.railway.line import Balise, Curve, Gradient, Line, SpeedLimit, Stop, Tunnel
from hil.railway.line_file import load_line
from hil.railway.resistance import GRAVITY_MPS2
from hil.railway.track import TrackResistance
from hil.railway.train import (
    DavisCoefficients,
    EffortCurve,
    ElectrodynamicBrake,
    PneumaticBrake,
    TractionDrive,
    Train,
)
from hil.railway.train_file import load_train

__all__ = [
    "GRAVITY_MPS2",
    "Balise",
    "Curve",
    "DavisCoefficients",
    "EffortCurve",
    "ElectrodynamicBrake",
    "Gradient",
    "Journey",
    "Line",
    "PneumaticBrake",
    "RailwayDataError",
    "SpeedLimit",
    "Stop",
    "TrackResistance",
    "TractionDrive",
    "Train",
    "Tunnel",
    "load_journey",
    "load_line",
    "load_train",
    "scenario_table",
]
