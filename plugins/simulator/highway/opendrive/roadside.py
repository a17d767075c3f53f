"""The outer edge of roads, where towns grow houses and trees."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.blocks import Shapes
from me3bev_plugins.simulator.highway.opendrive.lanes import HIGHWAY
from me3bev_plugins.simulator.highway.opendrive.records import PAVED, WALKING, Document, is_driven
from me3bev_plugins.simulator.highway.opendrive.shapes import SectionShape
from me3bev_plugins.simulator.highway.opendrive.sidewalks import has_sidewalk
from me3bev_plugins.simulator.highway.town import Floats

SPACING = 1.0


@dataclass(frozen=True, eq=False)
class Roadside:
    """One side of a road, outside junctions, a point each metre.

    `points` (P, 2) follow the outer edge of asphalt and sidewalk; `outward` (P, 2) point away from the road.
    """

    points: Floats
    outward: Floats
    urban: bool
    """It has a sidewalk."""
    highway: bool

    @property
    def length(self) -> float:
        """Metres, to within a metre."""
        return SPACING * (len(self.points) - 1)


def find_roadsides(document: Document, shapes: Shapes) -> Iterator[Roadside]:
    """Both sides of every road outside junctions."""
    for road in document.roads.values():
        if road.junction is not None or not is_driven(road):
            continue
        parts = [shapes[road.id, index] for index in range(len(road.sections))]
        highway = (road.limit(0.0) or 0.0) > HIGHWAY
        for sign in (1, -1):
            walked = sum(part.section.length for part in parts if has_sidewalk(part, sign))
            points = np.concatenate([part.line(_outermost(part, sign))[:, :2] for part in parts])
            normals = np.concatenate([sign * np.column_stack([-np.sin(p.heading), np.cos(p.heading)]) for p in parts])
            s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
            if s[-1] < 4.0:
                continue
            at = np.arange(0.0, s[-1], SPACING)
            even = [np.column_stack([np.interp(at, s, a[:, i]) for i in (0, 1)]) for a in (points, normals)]
            even[1] /= np.maximum(np.hypot(*even[1].T), 1e-9)[:, None]
            yield Roadside(even[0], even[1], walked > road.length / 2, highway)


def _outermost(shape: SectionShape, sign: int) -> Floats:
    wanted = PAVED | WALKING
    lanes = [lane.id for lane in shape.section.side(sign) if lane.type in wanted]
    return shape.edges[lanes[-1] if lanes else 0]
