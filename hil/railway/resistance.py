"""Resistance formulas of the trade: pure functions, each with its source and a worked example.

Specific resistances are in N/kN of train weight, which is the same number as permille of gradient.
"""

from __future__ import annotations

GRAVITY_MPS2 = 9.81
"""Acceleration of free fall, the value that railway tables and all papers used here take."""

CURVE_COEFFICIENT = 600.0
"""Curve resistance times radius [N/kN m], TB/T 1407.1-2018 and Nguyen (2020), equation 3."""

TUNNEL_COEFFICIENT = 0.00013
"""Tunnel resistance over tunnel length [N/kN/m], Nguyen (2020), equation 3."""

STARTING_PLAIN_BEARING_N_PER_KN = 5.0
"""Starting resistance with plain bearings [N/kN], TB/T 1407.1-2018."""

STARTING_ROLLER_BEARING_N_PER_KN = 3.5
"""Starting resistance with roller bearings [N/kN], TB/T 1407.1-2018."""


def specific_to_n(specific_n_per_kn: float, mass_kg: float) -> float:
    """Force [N] of a specific resistance [N/kN] on a train of this mass.

    >>> round(specific_to_n(6.0, 160_000.0), 3)   # +6 permille under 160 t
    9417.6
    """
    return specific_n_per_kn * mass_kg * GRAVITY_MPS2 * 1e-3


def n_to_specific(force_n: float, mass_kg: float) -> float:
    """Specific resistance [N/kN] of a force [N] on a train of this mass.

    >>> round(n_to_specific(9417.6, 160_000.0), 9)
    6.0
    """
    return force_n / (mass_kg * GRAVITY_MPS2 * 1e-3)


def davis_n(speed_mps: float, a_n: float, b_n_per_mps: float, c_n_per_mps2: float) -> float:
    """Running resistance a + b v + c v^2 [N], v in m/s; always against the motion, hence of |v|.

    Source: W. J. Davis (1926), here in SI. Coefficients in km/h: see `davis_from_kmh`.

    >>> davis_n(15.0, 2965.0, 230.0, 5.0)
    7540.0
    """
    speed = abs(speed_mps)
    return a_n + b_n_per_mps * speed + c_n_per_mps2 * speed * speed


def davis_from_kmh(
    a_n_per_kn: float, b_n_per_kn_per_kmh: float, c_n_per_kn_per_kmh2: float, mass_kg: float
) -> tuple[float, float, float]:
    """Davis coefficients in SI (N, N/(m/s), N/(m/s)^2) from A + B V + C V^2 [N/kN], V in km/h.

    >>> a, b, c = davis_from_kmh(1.75, 0.0234, 0.000184, 142_360.0)
    >>> round(a, 1), round(b, 2), round(c, 4)
    (2444.0, 117.65, 3.3303)
    """
    return (
        specific_to_n(a_n_per_kn, mass_kg),
        specific_to_n(b_n_per_kn_per_kmh * 3.6, mass_kg),
        specific_to_n(c_n_per_kn_per_kmh2 * 3.6 * 3.6, mass_kg),
    )


def gradient_n(permille: float, mass_kg: float) -> float:
    """Gradient force [N], positive uphill; small-angle form i * m g, as all sources here.

    The exact 1000 sin(atan(i/1000)) is lower by 0.02 % at 20 permille.

    >>> round(gradient_n(-17.0, 142_360.0))
    -23741
    """
    return specific_to_n(permille, mass_kg)


def curve_n_per_kn(radius_m: float, coefficient: float = CURVE_COEFFICIENT) -> float:
    """Curve resistance coefficient/R [N/kN]; the standard coefficient is 600 (TB/T 1407.1-2018).

    >>> curve_n_per_kn(500.0)
    1.2
    """
    return coefficient / radius_m


def curve_roeckl_n_per_kn(radius_m: float) -> float:
    """Curve resistance after Röckl [N/kN]: 650/(R-55) from 300 m up, 500/(R-30) below.

    The two branches do not meet at 300 m (2.65 and 1.85); that is in the source.
    Raises ValueError for a radius of 30 m or less, where the formula has no meaning.

    >>> round(curve_roeckl_n_per_kn(300.0), 3), round(curve_roeckl_n_per_kn(200.0), 3)
    (2.653, 2.941)
    """
    if not radius_m > 30.0:
        raise ValueError(f"radius {radius_m} m: Röckl's curve resistance needs more than 30 m")
    return 650.0 / (radius_m - 55.0) if radius_m >= 300.0 else 500.0 / (radius_m - 30.0)


def tunnel_n_per_kn(length_m: float) -> float:
    """Tunnel resistance 0.00013 L [N/kN] of a tunnel of L metres, Nguyen (2020), equation 3.

    >>> round(tunnel_n_per_kn(1000.0), 3)
    0.13
    """
    return TUNNEL_COEFFICIENT * length_m


def short_curve_n_per_kn(
    radius_m: float, curve_length_m: float, train_length_m: float, coefficient: float = CURVE_COEFFICIENT
) -> float:
    """Curve resistance [N/kN] of a train that wholly covers, or lies wholly in, one curve.

    600/R while the curve is at least as long as the train, else 600/R * L_r/L_c: Nguyen (2020),
    equation 3. (As printed its two cases compare the radius with the train length; meant is the
    curve length.) `Line.mean_specific_resistance` gives the same and all positions between.

    >>> short_curve_n_per_kn(500.0, 500.0, 80.0), round(short_curve_n_per_kn(500.0, 40.0, 80.0), 9)
    (1.2, 0.6)
    """
    return curve_n_per_kn(radius_m, coefficient) * min(1.0, curve_length_m / train_length_m)


def curtius_kniffler(speed_mps: float) -> float:
    """Adhesion coefficient of dry rail [1]: 0.161 + 7.5/(V + 44), V in km/h, Curtius/Kniffler (1950).

    >>> round(curtius_kniffler(0.0), 4), round(curtius_kniffler(15.0), 4)
    (0.3315, 0.2375)
    """
    return 0.161 + 7.5 / (abs(speed_mps) * 3.6 + 44.0)
