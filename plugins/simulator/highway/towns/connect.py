"""The curve of a connector: from the end of one lane to the start of another, of lines and arcs."""

from __future__ import annotations

import math

from me3bev_plugins.simulator.highway.towns.geometry import Path, Piece, Pose, beside, meet, wrap

STRAIGHT = 1e-5
"""Metres and radians below which two lanes count as one straight line."""


def connect(start: Pose, end: Pose) -> Path | None:
    """A path with continuous heading from `start` to `end`, or None where only a loop would do.

    A straight line where that fits; else a turn (line, arc, line) if the end lies ahead on one side; else two arcs.
    """
    return _line(start, end) or _turn(start, end) or _two_arcs(start, end)


def _ahead(start: Pose, x: float, y: float) -> float:
    return float((x - start[0]) * math.cos(start[2]) + (y - start[1]) * math.sin(start[2]))


def _aside(start: Pose, x: float, y: float) -> float:
    return float((y - start[1]) * math.cos(start[2]) - (x - start[0]) * math.sin(start[2]))


def _line(start: Pose, end: Pose) -> Path | None:
    run = _ahead(start, end[0], end[1])
    if run <= 0 or abs(wrap(end[2] - start[2])) > STRAIGHT or abs(_aside(start, end[0], end[1])) > STRAIGHT:
        return None
    return Path((Piece(*start, run),))


def _turn(start: Pose, end: Pose) -> Path | None:
    corner, turn = meet(start, end), wrap(end[2] - start[2])
    if corner is None or abs(turn) > math.radians(172):
        return None
    before, after = _ahead(start, *corner), -_ahead(end, *corner)
    tangent = min(before, after)
    if tangent <= 0.01:
        return None
    radius = tangent / math.tan(abs(turn) / 2)
    pieces = [Piece(*start, before - tangent)] if before - tangent > 1e-6 else []
    entry = beside(start, 0.0, before - tangent)
    pieces.append(Piece(*entry, radius * abs(turn), math.copysign(1 / radius, turn)))
    if after - tangent > 1e-6:
        leave = beside(end, 0.0, tangent - after)
        pieces.append(Piece(*leave, after - tangent))
    return Path(tuple(pieces))


def _two_arcs(start: Pose, end: Pose) -> Path | None:
    """The biarc with equal tangent lengths d at both ends: |v|^2 - 2 d v.(t0 + t1) + 2 d^2 (t0.t1 - 1) = 0."""
    (x0, y0, h0), (x1, y1, h1) = start, end
    vx, vy = x1 - x0, y1 - y0
    tx, ty = math.cos(h0) + math.cos(h1), math.sin(h0) + math.sin(h1)
    a, b, c = 2 * (math.cos(h1 - h0) - 1), -2 * (vx * tx + vy * ty), vx * vx + vy * vy
    if abs(a) < 1e-9:
        if b >= 0:
            return None
        d = -c / b
    else:
        d = (-b - math.sqrt(b * b - 4 * a * c)) / (2 * a)
    if d <= 0:
        return None
    x = (x0 + x1 + d * (math.cos(h0) - math.cos(h1))) / 2
    y = (y0 + y1 + d * (math.sin(h0) - math.sin(h1))) / 2
    first = _arc(start, x, y)
    if first is None:
        return None
    second = _arc(first.pose(first.length), x1, y1)
    return None if second is None else Path((first, second))


def _arc(start: Pose, x: float, y: float) -> Piece | None:
    """The arc leaving `start` along its heading that passes through (x, y), at most half a circle."""
    ahead, aside = _ahead(start, x, y), _aside(start, x, y)
    chord = math.hypot(ahead, aside)
    if ahead <= 1e-6:
        return None
    turn = 2 * math.atan2(aside, ahead)
    if abs(turn) < 1e-9:
        return Piece(*start, chord)
    return Piece(*start, chord * (turn / 2) / math.sin(turn / 2), 2 * aside / chord**2)
