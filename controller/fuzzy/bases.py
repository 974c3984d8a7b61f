"""The rule bases of the control laws, as tables that read like the papers'.

In every table the columns are the terms of the first input and the rows those of its rate of change, except
for the fuzzy PID, whose tables are printed the other way round and turned when they are read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple

from controller.fuzzy.rulebase import CentreAverage, Defuzzification, DiscreteCentroid, RuleBase, parse_rules
from controller.fuzzy.variable import FIVE_TERMS, SEVEN_TERMS, Variable

FUZZY_D_RULES = """
          |  NB   NS   Z    PS   PB
      ----+------------------------
       NB |  NB   NB   NM   Z    PS
       NS |  NB   NB   NS   PS   PM
       Z  |  NB   NM   Z    PM   PB
       PS |  NM   NS   PS   PB   PB
       PB |  NS   Z    PM   PB   PB
"""
"""Rules of the SpeedT and Fuzzy-D controllers (Tables 1 and 2 of the Fuzzy-D paper, which are identical).

Columns: speed error (reference minus measured). Rows: its rate of change. Cells: control.
"""

MATLAB_CENTROID = DiscreteCentroid(101)
"""MATLAB's default; the Fuzzy-D paper's numbers reproduce with 101 points and not with more."""

NINE_TERMS = ("NB", "NM", "NS", "N", "Z", "P", "PS", "PM", "PB")
"""Output terms of the fuzzy sliding mode. Plain N and P are the innermost: see `FSMC_RULES`."""

FSMC_RULES = """
          |  NB   NS   Z    PS   PB
      ----+------------------------
       NB |  NB   NM   NS   N    Z
       NS |  NM   NS   N    Z    P
       Z  |  NS   N    Z    P    PS
       PS |  N    Z    P    PS   PM
       PB |  Z    P    PS   PM   PB
"""
"""Rules of the fuzzy sliding mode (Table 1 of the FSMC paper). Columns: s. Rows: its rate of change.

Numbering the input terms NB..PB from -2 to 2, every one of the 25 printed cells is the sum of its two
numbers if, and only if, the outputs stand in the order NB NM NS N Z P PS PM PB: N and P are the innermost
sets, though the paper's text lists them elsewhere.
"""

TEXTBOOK_RULES: Mapping[str, str] = MappingProxyType(
    {
        "kp": """
          |  NB   NM   NS   Z    PS   PM   PB
      ----+----------------------------------
       NB |  PB   PB   PM   PM   PS   Z    Z
       NM |  PB   PB   PM   PS   PS   Z    NS
       NS |  PM   PM   PM   PS   Z    NS   NS
       Z  |  PM   PM   PS   Z    NS   NM   NM
       PS |  PS   PS   Z    NS   NS   NM   NM
       PM |  PS   Z    NS   NM   NM   NM   NB
       PB |  Z    Z    NM   NM   NM   NB   NB
""",
        "ki": """
          |  NB   NM   NS   Z    PS   PM   PB
      ----+----------------------------------
       NB |  NB   NB   NM   NM   NS   Z    Z
       NM |  NB   NB   NM   NS   NS   Z    Z
       NS |  NB   NM   NS   NS   Z    PS   PS
       Z  |  NM   NM   NS   Z    PS   PM   PM
       PS |  NM   NS   Z    PS   PS   PM   PB
       PM |  Z    Z    PS   PS   PM   PB   PB
       PB |  Z    Z    PS   PM   PM   PB   PB
""",
        "kd": """
          |  NB   NM   NS   Z    PS   PM   PB
      ----+----------------------------------
       NB |  PS   NS   NB   NB   NB   NM   PS
       NM |  PS   NS   NB   NM   NM   NS   Z
       NS |  Z    NS   NM   NM   NS   NS   Z
       Z  |  Z    NS   NS   NS   NS   NS   Z
       PS |  Z    Z    Z    Z    Z    Z    Z
       PM |  PB   NS   PS   PS   PS   PS   PB
       PB |  PB   PM   PM   PM   PS   PS   PB
""",
    }
)
"""Changes of the PID gains, the set found in textbooks. Rows: error. Columns: its rate of change.

The fuzzy-PID paper prints none of its tables; this common set has its terms and inputs. Trap: it is not
mirror-symmetric. With error = reference - measured it raises the proportional gain for a negative error and
lowers it for a positive one of the same size, against the paper's own rules, which speak of |error|.
Cell kd[PM][NM] is NS in one family of textbooks and PS in another.
"""

FOUR_TERMS = ("Z", "S", "M", "B")

SYMMETRIC_RULES: Mapping[str, str] = MappingProxyType(
    {
        "kp": """
          |  Z    S    M    B
      ----+------------------
       Z  |  PM   PM   PS   PS
       S  |  PS   PS   Z    Z
       M  |  NS   NS   NS   NM
       B  |  PB   PB   PB   PB
""",
        "ki": """
          |  Z    S    M    B
      ----+------------------
       Z  |  PB   PB   PM   PM
       S  |  PM   PM   PS   PS
       M  |  Z    Z    Z    NS
       B  |  NB   NB   NB   NB
""",
        "kd": """
          |  Z    S    M    B
      ----+------------------
       Z  |  PB   PM   Z    NS
       S  |  PM   PS   NS   NM
       M  |  Z    Z    Z    Z
       B  |  NB   NB   NB   NB
""",
    }
)
"""The fuzzy-PID paper's prose as tables. Rows: |error|. Columns: |rate of change|.

Its section 2 says, and the rows from the last to the first do: |error| large: a large proportional gain, a
small derivative gain against derivative saturation, and no integral (NB takes all of it away). Medium: a
smaller proportional gain for little overshoot, the other two moderate (unchanged). Small: greater
proportional and integral gains; the derivative gain large where |rate| is small and small where it is large.
How much each term is worth between these statements is our reading.
"""

SYMMETRIC_UNUSED: Mapping[str, tuple[str, ...]] = MappingProxyType({"kp": ("dkp.NB",), "ki": ("dki.NM",)})
"""Output terms that `SYMMETRIC_RULES` leaves idle: the prose never asks for them."""


class FuzzyPidRules(NamedTuple):
    """Three rule bases over the same inputs; outputs are changes in -3 .. 3 of each gain's range."""

    kp: RuleBase
    ki: RuleBase
    kd: RuleBase


def fuzzy_d_rules(
    error_peaks: Sequence[float],
    rate_peaks: Sequence[float],
    output_peaks: Sequence[float],
    *,
    output_unit: str = "m/s^2",
    defuzzification: Defuzzification = MATLAB_CENTROID,
) -> RuleBase:
    """Rule base of the Fuzzy-D paper over symmetric sets, given the positive peaks (2, 2 and 3 of them).

    SpeedT is the same base.
    """
    return RuleBase(
        error=Variable.symmetric("error", "m/s", FIVE_TERMS, error_peaks),
        rate=Variable.symmetric("rate", "m/s^2", FIVE_TERMS, rate_peaks),
        output=Variable.symmetric("output", output_unit, SEVEN_TERMS, output_peaks),
        rules=parse_rules(FUZZY_D_RULES, columns=FIVE_TERMS, rows=FIVE_TERMS),
        defuzzification=defuzzification,
    )


def fsmc_rules(half_range_s: float = 0.75, half_range_rate: float = 0.75) -> RuleBase:
    """Rule base of the FSMC paper: s [m/s] and its rate [m/s2] within +- half range, output -1 .. 1.

    25 rules, min, centre average over nine evenly spaced sets. The output has the sign of s.
    """
    return RuleBase(
        error=Variable.symmetric("s", "m/s", FIVE_TERMS, (0.5 * half_range_s, half_range_s)),
        rate=Variable.symmetric("rate", "m/s^2", FIVE_TERMS, (0.5 * half_range_rate, half_range_rate)),
        output=Variable.symmetric("output", "1", NINE_TERMS, (0.25, 0.5, 0.75, 1.0)),
        rules=parse_rules(FSMC_RULES, columns=FIVE_TERMS, rows=FIVE_TERMS),
        defuzzification=CentreAverage(),
    )


def fuzzy_pid_rules(
    error_range_mps: float = 3.0,
    rate_range_mps2: float = 3.0,
    *,
    tables: Literal["textbook", "symmetric"] = "textbook",
) -> FuzzyPidRules:
    """Three 7x7 rule bases for the changes of kp, ki and kd: product, centre average over -3 .. 3.

    Inputs run over +- their range, seven even triangles each, so each surface is the bilinear interpolation
    of its 49 integers. A gain is then `max(0, K0 + r T / 3)` with its range r and output T.
    """
    bases = []
    for gain in ("kp", "ki", "kd"):
        if tables == "textbook":
            cells = parse_rules(TEXTBOOK_RULES[gain], columns=SEVEN_TERMS, rows=SEVEN_TERMS)
        else:
            cells = mirrored(parse_rules(SYMMETRIC_RULES[gain], columns=FOUR_TERMS, rows=FOUR_TERMS))
        bases.append(
            RuleBase(
                error=Variable.symmetric("error", "m/s", SEVEN_TERMS, _thirds(error_range_mps)),
                rate=Variable.symmetric("rate", "m/s^2", SEVEN_TERMS, _thirds(rate_range_mps2)),
                output=Variable.symmetric(f"d{gain}", "1", SEVEN_TERMS, (1.0, 2.0, 3.0)),
                rules=tuple(zip(*cells, strict=True)),
                conjunction="product",
                defuzzification=CentreAverage(),
                unused=SYMMETRIC_UNUSED.get(gain, ()) if tables == "symmetric" else (),
            )
        )
    return FuzzyPidRules(*bases)


def mirrored(quarter: Sequence[Sequence[str]]) -> tuple[tuple[str, ...], ...]:
    """A table over |x| and |y|, terms from zero outwards, as one over x and y from negative to positive."""
    last = len(quarter) - 1
    away = [abs(k) for k in range(-last, last + 1)]
    return tuple(tuple(quarter[i][j] for j in away) for i in away)


def _thirds(half_range: float) -> tuple[float, float, float]:
    return half_range / 3.0, 2.0 * half_range / 3.0, half_range
