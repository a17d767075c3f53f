"""Curves against formulas that share nothing with the reader's."""

from __future__ import annotations

from math import cos, factorial, pi, sin, sqrt

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.opendrive.geometry import Cubics, Piece, ReferenceLine

S = np.linspace(0.0, 20.0, 41)


def test_line_runs_along_its_heading() -> None:
    x, y, heading, curvature = ReferenceLine((Piece(0, 3, -2, pi / 6, 20, "line", ()),)).at(S)
    np.testing.assert_allclose(x, 3 + S * sqrt(3) / 2, atol=1e-12)
    np.testing.assert_allclose(y, -2 + S / 2, atol=1e-12)
    assert np.all(heading == pi / 6)
    assert np.all(curvature == 0)


@pytest.mark.parametrize("k", [0.1, -0.04, 1e-13])
def test_arc_keeps_its_distance_from_its_centre(k: float) -> None:
    x, y, heading, _ = ReferenceLine((Piece(0, 5, 7, 0.4, 20, "arc", (k,)),)).at(S)
    if abs(k) > 1e-9:
        centre = (5 - sin(0.4) / k, 7 + cos(0.4) / k)
        np.testing.assert_allclose(np.hypot(x - centre[0], y - centre[1]), 1 / abs(k), rtol=1e-12)
    else:
        np.testing.assert_allclose(x, 5 + S * cos(0.4), atol=1e-9)
    np.testing.assert_allclose(heading, 0.4 + k * S, atol=1e-12)


def fresnel(t: float) -> tuple[float, float]:
    """(C, S): the integrals of cos(u^2) and sin(u^2) from 0 to t, by their power series."""
    c = sum((-1) ** n * t ** (4 * n + 1) / ((4 * n + 1) * factorial(2 * n)) for n in range(30))
    s = sum((-1) ** n * t ** (4 * n + 3) / ((4 * n + 3) * factorial(2 * n + 1)) for n in range(30))
    return c, s


def test_spiral_from_straight_is_a_fresnel_integral() -> None:
    end = 0.15
    line = ReferenceLine((Piece(0, 0, 0, 0, 20, "spiral", (0.0, end)),))
    x, y, heading, curvature = line.at(S)
    # Heading a^2 s^2 with a^2 = end / (2 * 20), so x = C(a s) / a.
    a = sqrt(end / 40)
    expected = np.array([fresnel(a * s) for s in S]) / a
    np.testing.assert_allclose(np.column_stack([x, y]), expected, atol=1e-10)
    np.testing.assert_allclose(heading, (a * S) ** 2, atol=1e-12)
    assert curvature[-1] == pytest.approx(end)


def test_spiral_between_two_curvatures_is_the_sum_of_small_steps() -> None:
    line = ReferenceLine((Piece(0, 1, 2, -0.7, 20, "spiral", (0.2, -0.1)),))
    fine = (np.arange(400_000) + 0.5) * (20 / 400_000)
    heading = -0.7 + 0.2 * fine - 0.3 / 40 * fine**2
    x, y, _, _ = line.at(np.array([20.0]))
    assert x[0] == pytest.approx(1 + np.cos(heading).mean() * 20, abs=1e-8)
    assert y[0] == pytest.approx(2 + np.sin(heading).mean() * 20, abs=1e-8)


@pytest.mark.parametrize("arc_length", [False, True])
def test_param_poly3_goes_by_arc_length(arc_length: bool) -> None:
    # A cubic of known shape; its length by fine summation.
    end = 18.0 if arc_length else 1.0
    scale = 1.0 / end
    u = (0.0, 15 * scale, 3 * scale**2, 0.0)
    v = (0.0, 0.0, 10 * scale**2, -4 * scale**3)
    p = np.linspace(0, end, 200_001)
    curve = np.column_stack([sum(c * p**n for n, c in enumerate(cs)) for cs in (u, v)])
    travelled = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    length = float(travelled[-1])
    line = ReferenceLine((Piece(0, 0, 0, 0, length, "paramPoly3", (*u, *v, end)),))
    s = np.linspace(0, length, 23)
    x, y, heading, _ = line.at(s)
    np.testing.assert_allclose(x, np.interp(s, travelled, curve[:, 0]), atol=2e-4)
    np.testing.assert_allclose(y, np.interp(s, travelled, curve[:, 1]), atol=2e-4)
    slope = np.arctan2(20 - 12, 15 + 6)
    assert heading[-1] == pytest.approx(slope)


def test_poly3_is_a_graph_over_its_own_axis() -> None:
    a, b, c, d = 0.0, 0.0, 0.02, -0.0005
    line = ReferenceLine((Piece(0, 0, 0, pi / 2, 15, "poly3", (a, b, c, d)),))
    x, y, _, _ = line.at(np.linspace(0, 15, 16))
    # Turned by a quarter, u is y and v is -x.
    np.testing.assert_allclose(-x, c * y**2 + d * y**3, atol=1e-4)
    assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(15, abs=0.01)


def test_pieces_follow_one_another() -> None:
    pieces = (Piece(0, 0, 0, 0, 10, "line", ()), Piece(10, 10, 0, 0, 10, "arc", (0.1,)))
    x, y, _, curvature = ReferenceLine(pieces).at(np.array([9.999999, 10.0, 10 + 5 * pi]))
    np.testing.assert_allclose(x, [10, 10, 20], atol=1e-5)
    np.testing.assert_allclose(y, [0, 0, 10], atol=1e-5)
    assert list(curvature) == [0, 0.1, 0.1]


def test_cubics_choose_the_piece_and_leave_out_what_begins_at_the_end() -> None:
    cubics = Cubics(np.array([0.0, 10.0]), np.array([[1.0, 0.5, 0, 0], [100.0, 0, 1, 0]]))
    np.testing.assert_allclose(cubics(np.array([0.0, 4.0, 10.0, 12.0])), [1, 3, 100, 104])
    np.testing.assert_allclose(cubics(np.array([10.0]), last=10.0), [6])
