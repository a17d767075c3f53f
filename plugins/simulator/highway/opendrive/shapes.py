"""Lane sections sampled: lane centres, edges and road outlines in the world.

Samples lie so close that a lane's heading turns by less than a degree from one to the next and no
two are over a metre apart on any lane.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.bounds import Samples, check_document, check_extent, check_shape
from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, Document, Road, Section
from me3bev_plugins.simulator.highway.town import Floats

STEP = 0.95
"""Metres between samples on straights."""
TURN = np.radians(0.75)
"""Most turn between samples."""
DENSEST = 50.0
"""Most samples per metre, whatever the curves of a damaged file say."""
WIDEST = 100.0
"""Most metres of a lane's width."""
PROBE = 0.5
"""Metres between the probes that measure how a section bends."""

Key = tuple[str, int, int]
"""(road id, section index, lane id)."""


@dataclass(frozen=True, eq=False)
class SectionShape:
    """A section at samples s (N,); `edges[lane]` (N,) is the lateral offset of that lane's outer edge, 0 the middle."""

    road: Road
    index: int
    section: Section
    s: Floats
    x: Floats
    y: Floats
    z: Floats
    heading: Floats
    edges: dict[int, Floats]

    def line(self, lateral: Floats) -> Floats:
        """(N, 3) points at a lateral offset (N,), left positive."""
        x = self.x - lateral * np.sin(self.heading)
        y = self.y + lateral * np.cos(self.heading)
        return np.column_stack([x, y, self.z])

    def inner(self, lane: int) -> Floats:
        """(N,) lateral offset of a lane's inner edge."""
        ids = [i for i in self.edges if i * lane > 0 and abs(i) < abs(lane)]
        return self.edges[max(ids, key=abs) if ids else 0]

    def width(self, lane: int) -> Floats:
        """(N,) metres."""
        return np.abs(self.edges[lane] - self.inner(lane))

    def centre(self, lane: int) -> Floats:
        """(N, 3) centre line of a lane, along s."""
        return self.line((self.edges[lane] + self.inner(lane)) / 2)

    def end(self, lane: int, at: int) -> Floats:
        """(3,) the first (0) or last (-1) point of a lane's centre line, along s."""
        lateral = (self.edges[lane][at] + self.inner(lane)[at]) / 2
        sin, cos = np.sin(self.heading[at]), np.cos(self.heading[at])
        return np.array([self.x[at] - lateral * sin, self.y[at] + lateral * cos, self.z[at]])


def section_shapes(document: Document) -> dict[tuple[str, int], SectionShape]:
    """Every section of every road, by (road id, section index).

    Raises:
        MapError: a road is where no road can be, or all together are too much.
    """
    check_document(document)
    samples = Samples(document)
    shapes = {}
    for road in document.roads.values():
        for shape in _road_shapes(road, samples):
            check_shape(document, shape)
            shapes[road.id, shape.index] = shape
    check_extent(document, shapes.values())
    return shapes


def _road_shapes(road: Road, samples: Samples) -> Iterator[SectionShape]:
    for index, section in enumerate(road.sections):
        s = _samples(road, section)
        samples.take(road, len(s) * (len(section.lanes) + 1))
        x, y, heading, _ = road.line.at(s)
        yield SectionShape(road, index, section, s, x, y, road.elevation(s), heading, _edges(road, section, s))


def _edges(road: Road, section: Section, s: Floats) -> dict[int, Floats]:
    edges = {0: road.offset(s, last=section.end)}
    for sign in (1, -1):
        lateral = edges[0]
        for lane in section.side(sign):
            lateral = lateral + sign * np.clip(lane.width(s - section.start), 0.0, WIDEST)
            edges[lane.id] = lateral
    return edges


def _samples(road: Road, section: Section) -> Floats:
    """Values of s from the section's start to its end, both included."""
    length = section.length
    probes = np.linspace(section.start, section.end, max(3, int(np.ceil(length / PROBE)) + 1))
    if length < 1e-3:
        return probes[[0, -1]]
    bend = np.abs(road.line.at(probes)[3])
    edges = _edges(road, section, probes)
    reach = np.max([np.abs(edge) for edge in edges.values()], axis=0)
    sway = _sway(section, edges, float(probes[1] - probes[0]))
    density = np.maximum((1.0 + bend * reach) / STEP, (bend + sway) / TURN)
    # A bend counts from one probe before it begins to one after it ends.
    density = np.maximum(density, np.maximum(np.append(density[1:], 0.0), np.append(0.0, density[:-1])))
    density = np.minimum(density, DENSEST)
    count = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(probes))])
    samples = np.interp(np.linspace(0.0, count[-1], max(1, int(np.ceil(count[-1]))) + 1), count, probes)
    samples[0], samples[-1] = section.start, section.end
    return samples


def _sway(section: Section, edges: dict[int, Floats], spacing: float) -> Floats:
    """How fast driving lanes turn relative to the reference line, radians per metre."""
    most = np.zeros_like(edges[0])
    for lane in section.lanes.values():
        if lane.type in DRIVING:
            slope = np.gradient(edges[lane.id], spacing)
            most = np.maximum(most, np.abs(np.gradient(slope, spacing)))
    return np.minimum(most, 0.5)
