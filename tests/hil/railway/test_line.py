from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from hil.railway import Balise, Curve, Gradient, Line, RailwayDataError, SpeedLimit, Stop, Tunnel
from hil.railway.resistance import short_curve_n_per_kn
from hil.railway.track import integral_at, mean_over_train

MILLIMETRE = 1e-3


def cuts(start: float, end: float, most: int) -> st.SearchStrategy[list[float]]:
    """Ascending cut points with at least a millimetre between them."""
    grid = st.integers(int(start / MILLIMETRE), int(end / MILLIMETRE))
    return st.lists(grid, unique=True, max_size=most).map(lambda cut: [c * MILLIMETRE for c in sorted(cut)])


def sections(values: st.SearchStrategy[float]) -> st.SearchStrategy[list[tuple[float, float, float]]]:
    """Sections without overlap on 0 to 1000 m: every other gap of the cuts, so some touch, some do not."""
    return st.tuples(cuts(0.0, 1000.0, 12), st.lists(st.none() | values, min_size=12, max_size=12)).map(
        lambda both: [
            (a, b, value)
            for a, b, value in zip(both[0], both[0][1:], both[1], strict=False)
            if value is not None
        ]
    )


gradient_sections = sections(st.floats(-40.0, 40.0))
curve_sections = sections(st.floats(100.0, 5000.0))
limit_sections = sections(st.sampled_from([5.0, 10.0, 15.0, 20.0, 25.0, 30.0]))
tunnel_sections = sections(st.floats(0.0, 2.0))
fronts = st.floats(-300.0, 1400.0)
lengths = st.floats(0.1, 400.0)


def hilly(gradients=(), curves=(), tunnels=(), limits=()) -> Line:
    return Line(
        name="random",
        start_m=0.0,
        end_m=1000.0,
        default_limit_mps=22.0,
        speed_limits=tuple(SpeedLimit(*s) for s in limits),
        gradients=tuple(Gradient(*s) for s in gradients),
        curves=tuple(Curve(*s) for s in curves),
        tunnels=tuple(Tunnel(*s) for s in tunnels),
    )


def direct_resistance(line: Line, x: float) -> float:
    """The definition, section by section, without arrays."""
    gradient = sum(g.permille for g in line.gradients if g.start_m <= x < g.end_m)
    curve = sum(line.curve_coefficient / c.radius_m for c in line.curves if c.start_m <= x < c.end_m)
    tunnel = sum(t.resistance_n_per_kn for t in line.tunnels if t.start_m <= x < t.end_m)
    return gradient + curve + tunnel


@settings(deadline=None, max_examples=60)
@given(gradient_sections, curve_sections, tunnel_sections, fronts, lengths)
def test_mean_over_the_train_equals_numeric_quadrature(gradients, curves, tunnels, front, length):
    line = hilly(gradients, curves, tunnels)
    points = 4001
    x = front - length + (np.arange(points) + 0.5) * length / points
    quadrature = float(np.mean([direct_resistance(line, p) for p in x]))
    # The midpoint rule errs by at most one cell for every step under the train: 33 edges, steps below 50.
    tolerance = 50.0 * 33 * 2 / points
    assert line.mean_specific_resistance(front, length) == pytest.approx(quadrature, abs=tolerance)


@settings(deadline=None, max_examples=100)
@given(gradient_sections, curve_sections, tunnel_sections, fronts, lengths)
def test_mean_over_the_train_is_the_overlap_weighted_sum(gradients, curves, tunnels, front, length):
    line = hilly(gradients, curves, tunnels)
    rear = front - length
    terms = [(g.start_m, g.end_m, g.permille) for g in line.gradients]
    terms += [(c.start_m, c.end_m, 600.0 / c.radius_m) for c in line.curves]
    terms += [(t.start_m, t.end_m, t.resistance_n_per_kn) for t in line.tunnels]
    exact = sum(value * max(0.0, min(b, front) - max(a, rear)) for a, b, value in terms) / length
    # differences of an integral up to 40e3 N/kN m, divided by at least 0.1 m
    assert line.mean_specific_resistance(front, length) == pytest.approx(exact, rel=1e-9, abs=1e-8)


@settings(deadline=None, max_examples=100)
@given(gradient_sections, curve_sections, fronts)
def test_a_train_of_no_length_feels_the_point_where_it_is(gradients, curves, position):
    line = hilly(gradients, curves)
    assert line.mean_specific_resistance(position, 0.0) == pytest.approx(direct_resistance(line, position))


@settings(deadline=None, max_examples=50)
@given(gradient_sections, fronts, lengths)
def test_mean_gradient_lies_between_the_extremes_under_the_train(gradients, front, length):
    line = hilly(gradients)
    values = [g.permille for g in line.gradients if g.start_m < front and g.end_m > front - length] + [0.0]
    assert min(values) - 1e-8 <= line.mean_gradient(front, length) <= max(values) + 1e-8


def test_compiled_mean_equals_the_plain_one(line):
    compiled_integral = njit(integral_at)
    track = line.track_resistance

    @njit
    def mean(edges, integral, front, length):
        return (
            compiled_integral(edges, integral, front) - compiled_integral(edges, integral, front - length)
        ) / length

    for front in np.linspace(-250.0, 1300.0, 400):
        args = (track.edges_m, track.integral_m, float(front), 80.0)
        assert mean(*args) == pytest.approx(mean_over_train(*args), abs=1e-12)


def test_integral_is_the_antiderivative_and_constant_outside(line):
    track = line.track_resistance
    assert integral_at(track.edges_m, track.integral_m, -1e6) == 0.0
    total = 100 * 10.0 + 20 * -20.0 + 200 * 2.0 + 300 * 0.5
    assert integral_at(track.edges_m, track.integral_m, 1e6) == pytest.approx(total)
    inner = np.interp(475.0, track.edges_m, track.integral_m)
    assert integral_at(track.edges_m, track.integral_m, 475.0) == pytest.approx(inner)


def test_arrays_of_a_frozen_line_cannot_be_written(line):
    with pytest.raises(ValueError, match="read-only"):
        line.track_resistance.specific_n_per_kn[0] = 1.0


def test_resistances_add_where_gradient_curve_and_tunnel_overlap(line):
    assert line.mean_specific_resistance(425.0) == pytest.approx(10.0)
    assert line.mean_specific_resistance(460.0) == pytest.approx(10.0 + 2.0)
    assert line.mean_specific_resistance(510.0) == pytest.approx(-20.0 + 2.0)
    assert line.mean_specific_resistance(620.0) == pytest.approx(2.0 + 0.5)
    assert line.gradient_permille(460.0) == 10.0
    assert line.gradient_permille(650.0) == 0.0


@pytest.mark.parametrize("curve_length_m", [20.0, 79.0, 80.0, 300.0])
def test_a_curve_shorter_than_the_train_counts_by_its_share(curve_length_m):
    line = hilly(curves=[(300.0, 300.0 + curve_length_m, 500.0)])
    mean = line.mean_specific_resistance(300.0 + max(curve_length_m, 80.0), 80.0)
    assert mean == pytest.approx(short_curve_n_per_kn(500.0, curve_length_m, 80.0))


def test_curve_coefficient_scales_the_curves_only(line):
    other = replace(line, curve_coefficient=3600.0)
    assert other.mean_specific_resistance(460.0) == pytest.approx(10.0 + 12.0)


@settings(deadline=None, max_examples=150)
@given(limit_sections, fronts, lengths)
def test_limit_is_the_lowest_anywhere_under_the_train(limits, front, length):
    line = hilly(limits=limits)
    rear = front - length
    places = [front, rear + 1e-9]
    for start, end, _ in limits:
        places += [x for x in (start, end, start - 1e-9) if rear < x <= front]
    expected = min(line.speed_limit_mps(x) for x in places)
    assert line.speed_limit_mps(front, length) == expected


@settings(deadline=None, max_examples=100)
@given(limit_sections, st.floats(0.0, 200.0), st.floats(0.0, 999.0))
def test_limit_profile_agrees_with_the_limit_at_every_front(limits, length, front):
    line = hilly(limits=limits)
    edges, values = line.speed_limit_profile(length)
    assert edges[0] == 0.0
    assert edges[-1] == 1000.0
    assert len(edges) == len(values) + 1
    assert np.all(np.diff(edges) > 0.0)
    assert np.all(np.diff(values) != 0.0), "neighbours of the same limit are merged"
    if np.min(np.abs(edges - front)) > 1e-6:
        assert values[np.searchsorted(edges, front, side="right") - 1] == line.speed_limit_mps(front, length)


def test_low_limit_lasts_until_the_rear_has_left_it(line):
    assert line.speed_limit_mps(199.9, 80.0) == 20.0
    assert line.speed_limit_mps(200.0, 80.0) == 10.0
    assert line.speed_limit_mps(379.9, 80.0) == 10.0
    assert line.speed_limit_mps(380.1, 80.0) == 15.0
    assert line.speed_limit_mps(430.0, 80.0) == 20.0


def test_a_limit_above_the_default_holds_only_when_the_whole_train_is_in_it():
    line = hilly(limits=[(100.0, 400.0, 30.0)])
    assert line.speed_limit_mps(150.0) == 30.0
    assert line.speed_limit_mps(150.0, 80.0) == 22.0
    assert line.speed_limit_mps(180.0, 80.0) == 30.0
    assert line.speed_limit_mps(400.0, 80.0) == 22.0


def test_breakpoints_are_all_section_ends_in_order(line):
    expected = [-100, 200, 300, 350, 400, 450, 500, 520, 600, 650, 900, 1100]
    assert line.breakpoints().tolist() == expected


def test_stops_are_found_by_name_and_by_index(line):
    assert line.stop("B") == Stop("B", 1000.0)
    assert line.stop(0) == Stop("A", 0.0)
    with pytest.raises(RailwayDataError, match=r"line test: no stop 'C'; it has 'A', 'B'"):
        line.stop("C")
    with pytest.raises(RailwayDataError, match=r"line test: no stop 2; it has 2"):
        line.stop(2)
    with pytest.raises(RailwayDataError, match="no stop -1"):
        line.stop(-1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"end_m": -100.0}, "end_m: -100 must be greater than start_m = -100"),
        (
            {"gradients": (Gradient(10.0, 5.0, 1.0),)},
            r"gradients#1.end_m: 5 must be greater than start_m = 10",
        ),
        (
            {"curves": (Curve(10.0, 30.0, 300.0), Curve(20.0, 40.0, 300.0))},
            r"curves: 20 to 40 m overlaps 10 to 30 m",
        ),
        ({"tunnels": (Tunnel(900.0, 1200.0, 0.1),)}, r"tunnels#1: 900 to 1200 m must lie on the line"),
        ({"stops": (Stop("A", 1101.0),)}, r"stops#1.position_m: 1101 \(A\) must lie on the line"),
        ({"balises": (Balise(7, 1.0), Balise(7, 2.0))}, r"balises#2: 7 is there twice"),
    ],
)
def test_a_line_that_contradicts_itself_cannot_be_made(line, change, message):
    with pytest.raises(RailwayDataError, match=message):
        replace(line, **change)


def test_sections_that_touch_do_not_overlap(line):
    touching = (SpeedLimit(0.0, 10.0, 5.0), SpeedLimit(10.0, 20.0, 6.0))
    assert replace(line, speed_limits=touching).speed_limit_mps(10.0) == 6.0


def test_a_step_belongs_to_the_section_that_begins_there(line):
    assert line.gradient_permille(400.0) == 10.0
    assert line.gradient_permille(500.0) == -20.0
    assert line.gradient_permille(520.0) == 0.0
    assert line.mean_specific_resistance(-100.0) == 0.0
    assert line.mean_specific_resistance(1100.0) == 0.0
