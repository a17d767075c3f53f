"""Plane curves of straight lines and circular arcs: how the centre lines of streets and connectors are drawn.

Metres and radians; headings counter-clockwise from x; curvature is positive to the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

Point = tuple[float, float]
Pose = tuple[float, float, float]
"""x, y, heading."""

TINY = 1e-9


def wrap(angle: float) -> float:
    """The angle in (-pi, pi]."""
    return math.pi - (math.pi - angle) % math.tau


def beside(pose: Pose, left: float, ahead: float = 0.0) -> Pose:
    """The pose moved `left` metres to its left and `ahead` metres forward, heading unchanged."""
    x, y, h = pose
    return (
        x - left * math.sin(h) + ahead * math.cos(h),
        y + left * math.cos(h) + ahead * math.sin(h),
        h,
    )


@dataclass(frozen=True)
class Piece:
    """A line (curvature 0) or an arc, from its starting pose on."""

    x: float
    y: float
    heading: float
    length: float
    curvature: float = 0.0

    def pose(self, s: float) -> Pose:
        """Where the piece is after `s` metres."""
        k, h = self.curvature, self.heading
        if abs(k) < TINY:
            return self.x + s * math.cos(h), self.y + s * math.sin(h), h
        turn = k * s
        # Half-angle form: exact for small turns, where the difference of sines would lose digits.
        chord = 2 * math.sin(turn / 2) / k
        return self.x + chord * math.cos(h + turn / 2), self.y + chord * math.sin(h + turn / 2), h + turn


@dataclass(frozen=True)
class Path:
    """Pieces joined end to end with continuous heading. A closed path ends where it starts."""

    pieces: tuple[Piece, ...]
    closed: bool = False

    @cached_property
    def length(self) -> float:
        """Metres."""
        return math.fsum(p.length for p in self.pieces)

    @cached_property
    def starts(self) -> tuple[float, ...]:
        """Station at which each piece begins."""
        out = [0.0]
        for piece in self.pieces[:-1]:
            out.append(out[-1] + piece.length)
        return tuple(out)

    def pose(self, s: float) -> Pose:
        """Where the path is at station `s` (any number of turns round a closed path)."""
        if self.closed:
            s %= self.length
        for start, piece in zip(reversed(self.starts), reversed(self.pieces), strict=True):
            if s >= start - TINY:
                return piece.pose(s - start)
        return self.pieces[0].pose(s)

    def cut(self, low: float, high: float) -> Path:
        """The open path from station `low` to `high`; on a closed path `high` may lie past the end."""
        turns = range(math.floor(low / self.length), math.ceil(high / self.length)) if self.closed else range(1)
        out = []
        for turn in turns:
            for start, piece in zip(self.starts, self.pieces, strict=True):
                a = max(low - turn * self.length, start)
                b = min(high - turn * self.length, start + piece.length)
                if b - a > 1e-6:
                    out.append(Piece(*piece.pose(a - start), b - a, piece.curvature))
        return Path(tuple(out))

    def offset(self, left: float) -> Path:
        """The parallel path `left` metres to the left."""
        out = []
        for p in self.pieces:
            scale = 1 - p.curvature * left
            if scale <= 0:
                raise ValueError(f"an arc of radius {1 / p.curvature:.1f} m has no parallel {left} m inside it")
            x, y, h = beside((p.x, p.y, p.heading), left)
            out.append(Piece(x, y, h, p.length * scale, p.curvature / scale))
        return Path(tuple(out), self.closed)

    def reversed(self) -> Path:
        """The same curve driven the other way."""
        out = []
        for p in reversed(self.pieces):
            x, y, h = p.pose(p.length)
            out.append(Piece(x, y, wrap(h + math.pi), p.length, -p.curvature))
        return Path(tuple(out), self.closed)

    def near(self, point: Point, reach: float) -> list[float]:
        """Stations where the path comes closest to `point`, one for each time it passes within `reach` metres."""
        count = max(2, math.ceil(self.length / 0.5))
        step = self.length / count
        stations = [i * step for i in range(count if self.closed else count + 1)]
        gaps = [math.dist(self.pose(s)[:2], point) for s in stations]
        found = []
        for i, gap in enumerate(gaps):
            before = gaps[i - 1] if i or self.closed else math.inf
            after = gaps[(i + 1) % len(gaps)] if i + 1 < len(gaps) or self.closed else math.inf
            if gap <= before and gap < after and gap < reach + step:
                s = self._closest(point, stations[i] - step, stations[i] + step)
                if math.dist(self.pose(s)[:2], point) <= reach:
                    found.append(s % self.length if self.closed else s)
        return found

    def beside(self, point: Point, guess: float) -> tuple[float, float]:
        """(station, metres to the left) of a point, found from a guess of the station."""
        s, left = guess, 0.0
        for _ in range(12):
            x, y, h = self.pose(s)
            dx, dy = point[0] - x, point[1] - y
            ahead, left = dx * math.cos(h) + dy * math.sin(h), dy * math.cos(h) - dx * math.sin(h)
            s += ahead
            if not self.closed:
                s = min(max(s, 0.0), self.length)
        return s, left

    def nearest(self, point: Point) -> float:
        """Station of the path's point nearest to `point`."""
        return min(self.near(point, math.inf), key=lambda s: math.dist(self.pose(s)[:2], point))

    def _closest(self, point: Point, low: float, high: float) -> float:
        if not self.closed:
            low, high = max(low, 0.0), min(high, self.length)
        for _ in range(80):
            a, b = low + (high - low) / 3, high - (high - low) / 3
            if math.dist(self.pose(a)[:2], point) < math.dist(self.pose(b)[:2], point):
                high = b
            else:
                low = a
        return (low + high) / 2

    @cached_property
    def tightest(self) -> float:
        """Smallest radius, metres; infinite for a straight path."""
        return min((1 / abs(p.curvature) for p in self.pieces if abs(p.curvature) > TINY), default=math.inf)


def polyline(*corners: Sequence[float], closed: bool = False) -> Path:
    """Straight lines through corners (x, y) or (x, y, radius), each corner rounded by an arc of its radius.

    The first and last corner of an open path need no radius; those of a closed path all do.
    """
    points = [(c[0], c[1]) for c in corners]
    radii = [c[2] if len(c) > 2 else 0.0 for c in corners]
    count = len(points)
    cuts, bends = [0.0] * count, [0.0] * count
    for i in range(count) if closed else range(1, count - 1):
        a, b, c = points[i - 1], points[i], points[(i + 1) % count]
        turn = wrap(math.atan2(c[1] - b[1], c[0] - b[0]) - math.atan2(b[1] - a[1], b[0] - a[0]))
        if abs(turn) > 1e-6 and radii[i] <= 0:
            raise ValueError(f"corner ({b[0]}, {b[1]}) turns by {math.degrees(turn):.1f} degrees and has no radius")
        bends[i], cuts[i] = turn, radii[i] * math.tan(abs(turn) / 2)
    pieces = []
    for i in range(count) if closed else range(count - 1):
        j = (i + 1) % count
        a, b = points[i], points[j]
        heading, run = math.atan2(b[1] - a[1], b[0] - a[0]), math.dist(a, b)
        straight = run - cuts[i] - cuts[j]
        if straight < -1e-6:
            raise ValueError(f"the arcs at {a} and {b} overlap by {-straight:.1f} m")
        start = beside((*a, heading), 0.0, cuts[i])
        if straight > 1e-6:
            pieces.append(Piece(*start, straight))
        if abs(bends[j]) > 1e-6:
            end = beside(start, 0.0, max(straight, 0.0))
            pieces.append(Piece(*end, radii[j] * abs(bends[j]), math.copysign(1 / radii[j], bends[j])))
    return Path(tuple(pieces), closed)


def circle(centre: Point, radius: float, start: float = 0.0) -> Path:
    """A closed circle driven counter-clockwise, from the direction `start` (radians) seen from its centre."""
    x, y = centre[0] + radius * math.cos(start), centre[1] + radius * math.sin(start)
    return Path((Piece(x, y, start + math.pi / 2, math.tau * radius, 1 / radius),), closed=True)


def arcs(pose: Pose, *runs: tuple[float, float]) -> Path:
    """A path from `pose` through runs of (length, signed radius), radius 0 for a straight line."""
    pieces = []
    for length, radius in runs:
        pieces.append(Piece(*pose, length, 1 / radius if radius else 0.0))
        pose = pieces[-1].pose(length)
    return Path(tuple(pieces))


def bulb(pose: Pose, flare: float, radius: float, gap: float = 0.0) -> Path:
    """A turnaround: from `pose` a bend right, a loop to the left and a bend right, back to where it began.

    With a `gap` it begins that many metres to the right of `pose` and ends as far to the left, so that those who
    leave it do not touch those who enter.
    """
    x, y, heading = pose
    start = (x + gap * math.sin(heading), y - gap * math.cos(heading), heading)
    angle = math.acos((flare + gap) / (flare + radius))
    return arcs(start, (flare * angle, -flare), (radius * (math.pi + 2 * angle), radius), (flare * angle, -flare))


def crossing(one: Path, other: Path, hint: Point) -> Point:
    """The point near `hint` where two paths cross: Newton's method, intersecting the tangents at the closest points."""
    point = hint
    for _ in range(60):
        met = meet(one.pose(one.nearest(point)), other.pose(other.nearest(point)))
        if met is None or math.dist(met, point) < 1e-9:
            break
        point = met
    return point


def meet(one: Pose, other: Pose) -> Point | None:
    """Where the straight lines through two poses cross, or None for parallels."""
    (x0, y0, h0), (x1, y1, h1) = one, other
    cross = math.sin(h1 - h0)
    if abs(cross) < 1e-7:
        return None
    ahead = ((x1 - x0) * math.sin(h1) - (y1 - y0) * math.cos(h1)) / cross
    return x0 + ahead * math.cos(h0), y0 + ahead * math.sin(h0)
