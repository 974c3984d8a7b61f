"""Units as they stand in a DBC, and what each is in SI. Exact fractions, so that no rounding enters here."""

from __future__ import annotations

from fractions import Fraction
from typing import Final

SI_UNITS: Final[dict[str, tuple[str, Fraction]]] = {}
"""DBC unit text -> (SI unit, factor): value in SI = value in the DBC's unit x factor. A fraction: "1"."""


def si_unit(unit: str) -> tuple[str, Fraction]:
    """SI unit and exact factor of a DBC unit text; KeyError if the text is not known."""
    return SI_UNITS[unit.strip()]


def _define(si: str, **factors: str) -> None:
    SI_UNITS[si] = (si, Fraction(1))
    for unit, factor in factors.items():
        SI_UNITS[unit] = (si, Fraction(factor))


SI_UNITS[""] = ("", Fraction(1))
_define("1", **{"%": "0.01", "‰": "0.001", "permille": "0.001", "ppm": "0.000001"})
_define("m", mm="0.001", cm="0.01", km="1000", um="0.000001")
_define("m/s", **{"km/h": "10/36", "kph": "10/36", "mm/s": "0.001", "cm/s": "0.01"})
_define("m/s^2", **{"m/s2": "1", "m/s²": "1", "m/s/s": "1", "mm/s^2": "0.001"})
_define("m/s^3", **{"m/s3": "1", "m/s³": "1"})
_define("N", kN="1000", daN="10", MN="1000000")
_define("Nm", kNm="1000")
# a keyword argument would turn the micro sign into the Greek letter: both are given as text
_define("s", ms="0.001", us="0.000001", ns="0.000000001", min="60", h="3600")
_define("s", **{"\u00b5s": "0.000001", "\u03bcs": "0.000001"})
_define("kg", t="1000", g="0.001")
_define("W", kW="1000", MW="1000000")
_define("J", kJ="1000", MJ="1000000", Wh="3600", kWh="3600000")
_define("V", kV="1000", mV="0.001")
_define("A", mA="0.001", kA="1000")
_define("Pa", kPa="1000", hPa="100", MPa="1000000", bar="100000", mbar="100")
_define("Hz", kHz="1000", rpm="1/60", **{"1/s": "1", "1/min": "1/60"})
_define("rad", **{"deg": "0.017453292519943295", "°": "0.017453292519943295"})
_define("degC", **{"°C": "1"})  # an SI unit by name (SI brochure, table 4)
_define("K")
