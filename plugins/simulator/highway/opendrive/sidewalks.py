"""Where people walk: sidewalk lanes, and the edge of roads that have none, joined into long lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.blocks import Shapes
from me3bev_plugins.simulator.highway.opendrive.footprint import Footprint
from me3bev_plugins.simulator.highway.opendrive.lanes import HIGHWAY, Network
from me3bev_plugins.simulator.highway.opendrive.records import WALKING, is_driven
from me3bev_plugins.simulator.highway.opendrive.shapes import SectionShape
from me3bev_plugins.simulator.highway.opendrive.surfaces import paved_lanes
from me3bev_plugins.simulator.highway.town import Floats, Ints, Sidewalk

NARROWEST = 1.0
"""Metres; a narrower sidewalk lane is a kerb."""
ROADSIDE = 1.5
"""Metres of width of a rural roadside strip."""
GAP = 45.0
"""Metres across a junction mouth or round a corner that a line may be carried on over free ground."""
SHORTEST = 6.0
"""Metres; shorter lines are dropped."""
ROWS = 256
SPACING = 4.0
"""Metres between points of a walking line where it is straight."""


@dataclass(frozen=True, eq=False)
class _Piece:
    points: Floats
    width: float
    paved: bool


def find_sidewalks(shapes: Shapes, network: Network, ground: Footprint) -> tuple[Sidewalk, ...]:
    """Walkable lines.

    Args:
        ground: lanes and surfaces taken.
    """
    walked = (shape for shape in shapes.values() if is_driven(shape.road) or shape.road.junction)
    pieces = [piece for shape in walked for piece in _pieces(shape, shapes, network)]
    pieces = [part for piece in pieces for part in (_free_parts(piece, ground) if not piece.paved else [piece])]
    walks = []
    for kind in (True, False):
        walks += [
            Sidewalk(points, width, kind) for points, width in _chains([p for p in pieces if p.paved == kind], ground)
        ]
    return tuple(walk for walk in walks if _length(walk.points) >= SHORTEST)


def has_sidewalk(shape: SectionShape, sign: int) -> bool:
    """Whether one side of a section has a sidewalk wide enough to walk on."""
    return any(
        lane.type in WALKING and float(shape.width(lane.id).mean()) >= NARROWEST for lane in shape.section.side(sign)
    )


def _pieces(shape: SectionShape, shapes: Shapes, network: Network) -> Iterator[_Piece]:
    road = shape.road
    if (road.limit(shape.section.start) or 0.0) > HIGHWAY:
        return  # Nobody walks along a motorway.
    for lane in shape.section.lanes.values():
        if lane.id != 0 and lane.type in WALKING and shape.section.length > 0.05:
            width = float(shape.width(lane.id).mean())
            if width >= NARROWEST:
                yield _Piece(_thin(shape.centre(lane.id)[:, :2]), width, True)
    every = (shapes[road.id, index] for index in range(len(road.sections)))
    if road.junction or any(has_sidewalk(s, side) for s in every for side in (1, -1)):
        return
    for sign in (1, -1):
        if any((road.id, shape.index, lane.id) in network.of for lane in shape.section.side(sign)):
            edge = verge(shape, sign)
            yield _Piece(_thin(shape.line(edge + sign * (ROADSIDE / 2 + 0.25))[:, :2]), ROADSIDE, False)


def verge(shape: SectionShape, sign: int) -> Floats:
    """(N,) lateral offset of the outer edge of asphalt on one side."""
    paved = [number for number in paved_lanes(shape) if number * sign > 0]
    return shape.edges[max(paved, key=abs) if paved else 0]


def _thin(points: Floats) -> Floats:
    """Points every few metres, closer in bends; both ends kept."""
    steps = np.diff(points, axis=0)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    angle = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(angle, prepend=angle[0])))])
    progress = np.floor(length / SPACING + turned / np.radians(8.0))
    keep = np.concatenate([[True], np.diff(progress) > 0])
    keep[-1] = True
    return points[keep]


def _free_parts(piece: _Piece, ground: Footprint) -> Iterator[_Piece]:
    """The stretches of a roadside that no other road covers."""
    fine = _resample(piece.points, 1.0)
    free = ground.is_free(fine)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    for first, last in edges.reshape(-1, 2):
        if last - first >= 3:
            yield _Piece(_thin(fine[first:last]), piece.width, piece.paved)


def _resample(points: Floats, spacing: float) -> Floats:
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, s[-1], max(2, int(np.ceil(s[-1] / spacing)) + 1))
    return np.column_stack([np.interp(at, s, points[:, 0]), np.interp(at, s, points[:, 1])])


def _length(points: Floats) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _chains(pieces: list[_Piece], ground: Footprint) -> Iterator[tuple[Floats, float]]:
    """Pieces joined end to end, nearest ends first, over free ground only."""
    if not pieces:
        return
    links = _links(pieces, ground)
    done: set[int] = set()
    starts = [end for end in range(2 * len(pieces)) if end not in links]
    for start in [*starts, *range(2 * len(pieces))]:  # Whatever is left after the open lines is a closed ring.
        if start // 2 in done:
            continue
        parts: list[Floats] = []
        widths: list[tuple[float, float]] = []
        end = start
        while end // 2 not in done:
            piece = pieces[end // 2]
            done.add(end // 2)
            parts.append(piece.points if end % 2 == 0 else piece.points[::-1])
            widths.append((piece.width, _length(piece.points)))
            following = links.get(end ^ 1)
            if following is None:
                break
            parts.append(following[1])
            end = following[0]
        points = np.concatenate(parts)
        keep = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 0.05])
        total = sum(length for _, length in widths)
        yield points[keep], sum(width * length for width, length in widths) / max(total, 1e-9)


def _links(pieces: list[_Piece], ground: Footprint) -> dict[int, tuple[int, Floats]]:
    """For each joined end (piece i starts at 2 i, ends at 2 i + 1) the end it leads to and the way there."""
    ends = np.array([p.points[i] for p in pieces for i in (0, -1)])
    outward = np.array([d / max(np.hypot(*d), 1e-9) for p in pieces for d in _outward(p.points)])
    first, second, distance = _near_pairs(ends)
    chain = list(range(len(pieces)))

    def find(piece: int) -> int:
        while chain[piece] != piece:
            chain[piece] = chain[chain[piece]]
            piece = chain[piece]
        return piece

    links: dict[int, tuple[int, Floats]] = {}
    for pair in np.argsort(distance, kind="stable"):
        a, b = int(first[pair]), int(second[pair])
        if a in links or b in links or find(a // 2) == find(b // 2):
            continue
        way = _way(ends[a], outward[a], ends[b], outward[b], ground)
        if way is not None:
            links[a], links[b] = (b, way), (a, way[::-1])
            chain[find(a // 2)] = find(b // 2)
    return links


def _near_pairs(ends: Floats) -> tuple[Ints, Ints, Floats]:
    """Indices of each two ends nearer than `GAP`, and how far apart they are; a block of rows at a time."""
    found: list[tuple[Ints, Ints, Floats]] = []
    for low in range(0, len(ends), ROWS):
        rows = ends[low : low + ROWS]
        distance = np.hypot(rows[:, None, 0] - ends[None, :, 0], rows[:, None, 1] - ends[None, :, 1])
        first, second = np.nonzero(distance < GAP)
        upper = second > first + low
        first, second = first[upper], second[upper]
        found.append((first + low, second, distance[first, second]))
    return tuple(np.concatenate(part) for part in zip(*found, strict=True))  # type: ignore[return-value]


def _outward(points: Floats) -> tuple[Floats, Floats]:
    return points[0] - points[min(1, len(points) - 1)], points[-1] - points[max(-2, -len(points))]


def _way(a: Floats, leaving: Floats, b: Floats, arriving: Floats, ground: Footprint) -> Floats | None:
    """Points between two ends, bent round the corner where their directions meet, if nothing is in the way."""
    gap = b - a
    distance = float(np.hypot(*gap))
    if leaving @ arriving > 0.5:
        return None  # Side by side, not one after the other.
    if distance < 1.0:
        return np.empty((0, 2))
    if leaving @ gap < 0.2 * distance or arriving @ gap > -0.2 * distance:
        return None
    corner = (a + b) / 2
    cross = leaving[0] * arriving[1] - leaving[1] * arriving[0]
    if abs(cross) > 0.2:
        corner = a + leaving * max(0.0, (gap[0] * arriving[1] - gap[1] * arriving[0]) / cross)
    t = np.linspace(0.0, 1.0, max(3, int(distance / 2) + 2))[:, None]
    way = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b
    return way[1:-1] if bool(ground.is_free(_resample(way, 0.5)[2:-2]).all()) else None
