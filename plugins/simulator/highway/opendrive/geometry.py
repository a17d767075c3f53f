"""Plane curves of OpenDRIVE reference lines: line, arc, spiral, poly3, paramPoly3, and piecewise cubics in s.

Everything is vectorised over samples; angles in radians, lengths in metres, curvature positive to the left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Literal

import numpy as np

from me3bev_plugins.simulator.highway.town import Floats

Curve = Literal["line", "arc", "spiral", "poly3", "paramPoly3"]
PARAMETERS = {"line": 0, "arc": 1, "spiral": 2, "poly3": 4, "paramPoly3": 9}
"""How many values each curve takes: curvatures, then polynomial coefficients; a paramPoly3 ends with its range."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_MOST_PANELS = 400
"""Enough for a spiral of a hundred turns."""
_TABLE = 257
"""Samples of a polynomial curve from which arc length is inverted."""


@dataclass(frozen=True, eq=False)
class Cubics:
    """Piecewise cubic a + b d + c d^2 + d d^3 with d measured from the start of each piece.

    `start` (N,) ascending, `coefficients` (N, 4). Before the first start the first piece holds.
    """

    start: Floats
    coefficients: Floats

    def __call__(self, s: Floats, last: float = np.inf) -> Floats:
        """Values at s; pieces that start at or after `last` are left out, so that a section's end stays its own."""
        piece = np.searchsorted(self.start, np.minimum(s + 1e-9, last - 1e-6), side="right") - 1
        piece = np.clip(piece, 0, None)
        d = s - self.start[piece]
        a, b, c, e = self.coefficients[piece].T
        return a + d * (b + d * (c + d * e))


ZERO = Cubics(np.zeros(1), np.zeros((1, 4)))


@dataclass(frozen=True)
class Piece:
    """One geometry record: where it starts, its pose there, its length and its curve."""

    s: float
    x: float
    y: float
    heading: float
    length: float
    curve: Curve
    values: tuple[float, ...]

    def local(self, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """(u, v, turn, curvature) at d metres along the piece, in the frame of its start."""
        if self.curve == "line":
            zero = np.zeros_like(d)
            return d, zero, zero, zero
        if self.curve == "arc":
            return _clothoid(d, self.values[0], 0.0)
        if self.curve == "spiral":
            first, last = self.values
            return _clothoid(d, first, (last - first) / self.length if self.length > 0 else 0.0)
        return self._polynomial(d)

    def _polynomial(self, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        p = np.interp(d / max(self.length, 1e-9), self._fractions, self._parameters)
        u, du, ddu = _cubic(self._u, p)
        v, dv, ddv = _cubic(self._v, p)
        speed = np.maximum(np.hypot(du, dv), 1e-9)
        return u, v, np.arctan2(dv, du), (du * ddv - dv * ddu) / speed**3

    @cached_property
    def _u(self) -> tuple[float, ...]:
        return self.values[:4] if self.curve == "paramPoly3" else (0.0, 1.0, 0.0, 0.0)

    @cached_property
    def _v(self) -> tuple[float, ...]:
        return self.values[4:8] if self.curve == "paramPoly3" else self.values

    @cached_property
    def _parameters(self) -> Floats:
        # A poly3 is no longer along u than along its arc.
        return np.linspace(0.0, self.values[8] if self.curve == "paramPoly3" else self.length, _TABLE)

    @cached_property
    def _fractions(self) -> Floats:
        """Share of the piece's length reached at each tabled parameter."""
        p = self._parameters
        speed = np.hypot(_cubic(self._u, p)[1], _cubic(self._v, p)[1])
        middle = (p[:-1] + p[1:]) / 2
        centre = np.hypot(_cubic(self._u, middle)[1], _cubic(self._v, middle)[1])
        arc = np.concatenate([[0.0], np.cumsum((speed[:-1] + 4 * centre + speed[1:]) / 6 * np.diff(p))])
        if self.curve == "poly3":
            return arc / max(self.length, 1e-9)
        return arc / arc[-1] if arc[-1] > 0 else np.linspace(0.0, 1.0, _TABLE)


def _cubic(c: tuple[float, ...], p: Floats) -> tuple[Floats, Floats, Floats]:
    """Value, first and second derivative."""
    return (
        c[0] + p * (c[1] + p * (c[2] + p * c[3])),
        c[1] + p * (2 * c[2] + 3 * p * c[3]),
        2 * c[2] + 6 * p * c[3],
    )


def _clothoid(d: Floats, curvature: float, rate: float) -> tuple[Floats, Floats, Floats, Floats]:
    """A curve whose curvature is `curvature + rate d`: an arc when rate is 0, else an Euler spiral.

    The spiral integrates cos and sin of the turn by Gauss-Legendre panels short enough for full precision.
    """
    turn = d * (curvature + rate * d / 2)
    if rate == 0.0:
        half = turn / 2
        chord = d * np.sinc(half / np.pi)
        return chord * np.cos(half), chord * np.sin(half), turn, np.full_like(d, curvature)
    furthest = float(np.abs(d).max(initial=0.0))
    panels = 1 + min(int(furthest * (abs(curvature) + abs(rate) * furthest) / 2), _MOST_PANELS)
    edges = np.arange(panels)[:, None]
    fraction = ((edges + (_NODES + 1) / 2) / panels).ravel()
    weight = np.tile(_WEIGHTS / (2 * panels), panels)
    at = d[:, None] * fraction
    angle = at * (curvature + rate * at / 2)
    return d * (np.cos(angle) @ weight), d * (np.sin(angle) @ weight), turn, curvature + rate * d


@dataclass(frozen=True, eq=False)
class ReferenceLine:
    """The plan view of a road: pieces in order of s."""

    pieces: tuple[Piece, ...]

    @cached_property
    def starts(self) -> Floats:
        """(N,) s of each piece."""
        return np.array([piece.s for piece in self.pieces])

    def at(self, s: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """(x, y, heading, curvature) in the world at each s."""
        which = np.clip(np.searchsorted(self.starts, s + 1e-9, side="right") - 1, 0, None)
        x, y, heading, curvature = (np.empty_like(s) for _ in range(4))
        ends = [*(np.flatnonzero(np.diff(which)) + 1), len(which)]
        for low, high in pairwise([0, *ends] if len(which) else []):
            piece = self.pieces[which[low]]
            chosen = slice(low, high)
            u, v, turn, bend = piece.local(s[chosen] - piece.s)
            cos, sin = np.cos(piece.heading), np.sin(piece.heading)
            x[chosen] = piece.x + u * cos - v * sin
            y[chosen] = piece.y + u * sin + v * cos
            heading[chosen] = piece.heading + turn
            curvature[chosen] = bend
        return x, y, heading, curvature
