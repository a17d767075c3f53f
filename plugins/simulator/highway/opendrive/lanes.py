"""Driving lanes of a document as one network: joined centre lines, links, neighbours, widths, limits, markings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.blocks import (
    Block,
    Shapes,
    branch_tapers,
    find_blocks,
    join_through_short,
)
from me3bev_plugins.simulator.highway.opendrive.graph import Links, lane_links
from me3bev_plugins.simulator.highway.opendrive.joints import dense, share_joints, smooth, strongest_component
from me3bev_plugins.simulator.highway.opendrive.records import Document
from me3bev_plugins.simulator.highway.opendrive.shapes import Key
from me3bev_plugins.simulator.highway.town import Floats, Marking, Turn

SOLID = ("solid", "yellow_solid")
HIGHWAY = 100 / 3.6
"""m/s; a nominal limit above it makes a motorway."""
NARROWEST = 1.0
"""Metres; a narrower lane has been closed."""
TOUCHING = 2.0
"""Metres between two lane ends that can be one joint."""
FALLBACK = 30 / 3.6
"""m/s, where the file gives no limit."""


@dataclass(eq=False)
class Draft:
    """A lane of the town in the making; ids are positions in `Network.lanes`."""

    keys: tuple[Key, ...]
    """Its pieces in driving order."""
    begins: tuple[float, ...]
    """Arc length at which each piece begins, before joints were shared."""
    points: Floats
    width: float
    nominal: float | None
    junction: str | None
    left_marking: Marking
    right_marking: Marking
    left: int | None = None
    right: int | None = None
    successors: list[int] = field(default_factory=list)
    predecessors: list[int] = field(default_factory=list)
    limit: float = FALLBACK
    highway: bool = False

    @property
    def reachable(self) -> list[int]:
        """Lanes one can drive to from this one: what follows and what may be changed to."""
        return [*self.successors, *(n for n in (self.left, self.right) if n is not None)]

    @property
    def length(self) -> float:
        """Metres in the plane."""
        return float(np.hypot(*np.diff(self.points[:, :2], axis=0).T).sum())

    @property
    def headings(self) -> tuple[float, float]:
        """Direction of travel at its start and its end."""
        first, last = self.points[1] - self.points[0], self.points[-1] - self.points[-2]
        return float(np.arctan2(first[1], first[0])), float(np.arctan2(last[1], last[0]))

    @property
    def turn(self) -> Turn:
        """The manoeuvre, from how much the lane turns from one end to the other."""
        steps = np.diff(self.points[:, :2], axis=0)
        angle = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        change = float(np.degrees(angle[-1] - angle[0]))
        if abs(change) > 150:
            return "uturn"
        if abs(change) < 30:
            return "straight"
        return "left" if change > 0 else "right"


@dataclass(frozen=True, eq=False)
class Network:
    """The lanes of a town, strongly connected; `of` finds the lane of a piece of the file."""

    lanes: list[Draft]
    of: dict[Key, int]
    left_out: float = 0.0
    """Metres of driving lanes that are no part of it: dead ends, roads apart from the others."""


def build_network(document: Document, shapes: Shapes) -> Network:
    """Lanes that can be driven for ever, with shared end points.

    Raises:
        MapError: no driving lane leads anywhere.
    """
    links = join_through_short(_meeting(lane_links(document), shapes), shapes)
    links, tapers = branch_tapers(links, shapes)
    drafts: list[Draft] = []
    for block in find_blocks(document, links):
        drafts.extend(_drafts(document, shapes, block, len(drafts)))
    of = {key: index for index, draft in enumerate(drafts) for key in draft.keys}
    for draft in drafts:
        draft.successors = sorted({of[target] for target in links[draft.keys[-1]]})
    keep = strongest_component([draft.reachable for draft in drafts], [draft.length for draft in drafts])
    kept = [draft for draft, wanted in zip(drafts, keep, strict=True) if wanted]
    if not any(draft.successors for draft in kept):
        raise MapError(
            "no driving lane leads back to where it began, so nothing could drive on for ever",
            where=document.where,
            hint="Link its roads into at least one closed course",
        )
    _renumber(kept, [int(n) for n in np.cumsum(keep) - 1], keep)
    loose = [((draft.keys[0], 0) in tapers, (draft.keys[-1], -1) in tapers) for draft in kept]
    joined = share_joints([smooth(draft.points) for draft in kept], [draft.successors for draft in kept], loose)
    for draft, points in zip(kept, joined, strict=True):
        draft.points = dense(points)
    left_out = sum(draft.length for draft, wanted in zip(drafts, keep, strict=True) if not wanted)
    return Network(kept, {key: index for index, draft in enumerate(kept) for key in draft.keys}, left_out)


def _meeting(links: Links, shapes: Shapes) -> Links:
    """The lanes wide enough to drive, and the links whose two ends lie together; a file may link roads far apart."""

    def end(key: Key, last: bool) -> Floats:
        return shapes[key[:2]].end(key[2], -1 if (key[2] < 0) == last else 0)

    wide = {key for key in links if float(shapes[key[:2]].width(key[2]).max()) >= NARROWEST}
    return {
        key: [n for n in links[key] if n in wide and float(np.abs(end(key, True) - end(n, False)).max()) < TOUCHING]
        for key in links
        if key in wide
    }


def _renumber(kept: list[Draft], position: Sequence[int], keep: list[bool]) -> None:
    for index, draft in enumerate(kept):
        draft.successors = [position[n] for n in draft.successors if keep[n]]
        draft.left = position[draft.left] if draft.left is not None and keep[draft.left] else None
        draft.right = position[draft.right] if draft.right is not None and keep[draft.right] else None
        for target in draft.successors:
            kept[target].predecessors.append(index)


def _drafts(document: Document, shapes: Shapes, block: Block, first: int) -> list[Draft]:
    """The lanes of a block, from the middle outwards, numbered from `first`."""
    drafts = [_draft(document, shapes, chain) for chain in block.chains]
    for index in range(len(drafts) - 1):
        inner, outer = drafts[index], drafts[index + 1]
        adjacent = abs(inner.keys[0][2]) + 1 == abs(outer.keys[0][2])
        if adjacent and inner.junction is None and inner.right_marking not in SOLID:
            inner.right, outer.left = first + index + 1, first + index
    return drafts


def _draft(document: Document, shapes: Shapes, chain: tuple[Key, ...]) -> Draft:
    parts: list[Floats] = []
    widths: list[Floats] = []
    begins: list[float] = []
    travelled = 0.0
    for key in chain:
        points, width = shapes[key[:2]].centre(key[2]), shapes[key[:2]].width(key[2])
        if key[2] > 0:
            points, width = points[::-1], width[::-1]
        if parts:
            parts[-1] = parts[-1].copy()
            parts[-1][-1] = (parts[-1][-1] + points[0]) / 2
            points, width = points[1:], width[1:]
            step = np.vstack([parts[-1][-1:], points])
        else:
            step = points
        begins.append(travelled)
        travelled += float(np.hypot(*np.diff(step[:, :2], axis=0).T).sum())
        parts.append(points)
        widths.append(width)
    road = document.roads[chain[0][0]]
    return Draft(
        keys=chain,
        begins=tuple(begins),
        points=np.concatenate(parts),
        width=max(float(np.quantile(np.concatenate(widths), 0.75)), NARROWEST),
        nominal=road.limit(road.sections[chain[0][1]].start),
        junction=road.junction,
        left_marking=_marking(document, chain, outer=False),
        right_marking=_marking(document, chain, outer=True),
    )


def _marking(document: Document, chain: tuple[Key, ...], *, outer: bool) -> Marking:
    """The marking along most of a lane's outer or inner line."""
    metres: dict[Marking, float] = {}
    for road, index, lane in chain:
        section = document.roads[road].sections[index]
        side = [0] + [record.id for record in section.side(1 if lane > 0 else -1)]
        line = section.lanes.get(lane if outer else side[side.index(lane) - 1])
        marks = sorted(line.marks) if line is not None else []
        ends = [min(mark[0], section.length) for mark in marks[1:]] + [section.length]
        for (start, kind, colour), end in zip(marks, ends, strict=bool(marks)):
            name = marking(kind, colour)
            metres[name] = metres.get(name, 0.0) + max(end - start, 0.0)
    return max(metres, key=metres.__getitem__) if metres else "none"


def marking(kind: str, colour: str) -> Marking:
    """The town's word for a roadMark; a double line with a solid half counts as solid."""
    yellow = colour in ("yellow", "orange")
    if "solid" in kind:
        return "yellow_solid" if yellow else "solid"
    if "broken" in kind or kind == "botts dots":
        return "yellow_broken" if yellow else "broken"
    return "none"
