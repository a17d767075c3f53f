"""What a file may ask for: sizes beyond these are a fault of the file, found before they cost memory or time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, Document, Road

if TYPE_CHECKING:
    from me3bev_plugins.simulator.highway.opendrive.shapes import SectionShape

HINT = "Check the file, or export it as OpenDRIVE 1.4 or later again"
LONGEST_TOTAL = 2_000_000.0
"""Metres of all roads together."""
MOST_SECTIONS = 20_000
MOST_LANES = 100
"""Lanes of one section."""
MOST_CROSSWALKS = 5_000
MOST_SAMPLES = 6_000_000
"""Samples of all lane edges; a large published town has a fiftieth of it."""
WIDEST = 15_000.0
"""Metres from one side of a town to the other."""
HIGHEST = 9_000.0
"""Metres above or below zero."""
BESIDE = 300.0
"""Metres from a road's reference line to its outermost lane."""
WIDEST_LANE = 25.0
"""Metres of a driving lane."""
LONGEST_JUMP = 10.0
"""Metres that a reference line or a driving lane may jump where two curves do not meet."""


def check_document(document: Document) -> None:
    """Raises MapError for a document larger than any town."""
    roads = document.roads.values()
    crosswalks = sum(item.type == "crosswalk" for road in roads for item in road.objects)
    for what, value, most in (
        ("metres of road", sum(road.length for road in roads), LONGEST_TOTAL),
        ("lane sections", sum(len(road.sections) for road in roads), MOST_SECTIONS),
        ("crosswalks", crosswalks, MOST_CROSSWALKS),
    ):
        if value > most:
            raise MapError(
                f"the file has {value:,.0f} {what}", where=document.where, allowed=f"at most {most:,.0f}",
                hint="Cut the map up",
            )  # fmt: skip
    for road in roads:
        for section in road.sections:
            if len(section.lanes) > MOST_LANES:
                raise _fault(document, road, f"the section at s={section.start:g} has {len(section.lanes)} lanes")


class Samples:
    """Counts the samples of a document, so that a damaged curve cannot ask for all memory."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.left = MOST_SAMPLES

    def take(self, road: Road, count: int) -> None:
        """Raises MapError when there are no more."""
        self.left -= count
        if self.left < 0:
            raise _fault(self.document, road, "its curves need more samples than a whole town may have")


def check_shape(document: Document, shape: SectionShape) -> None:
    """Raises MapError for a section that jumps, or lies where no road can be."""
    line = np.column_stack([shape.x, shape.y])
    if not np.isfinite(line).all() or not np.isfinite(shape.z).all():
        raise _fault(
            document, shape.road, f"<geometry> or <elevation> at s={shape.section.start:g} has no finite place"
        )
    if np.abs(shape.z).max() > HIGHEST:
        raise _fault(document, shape.road, f"<elevation> reaches {np.abs(shape.z).max():g} m")
    jump = np.hypot(*np.diff(line, axis=0).T)
    if jump.max(initial=0.0) > LONGEST_JUMP:
        at = shape.s[int(jump.argmax())]
        raise _fault(document, shape.road, f"<geometry> jumps by {jump.max():.1f} m at s={at:.1f}")
    for number, edge in shape.edges.items():
        if not np.abs(edge).max() < BESIDE:
            raise _fault(document, shape.road, f"lane {number} lies {np.abs(edge).max():g} m beside its road")
    for lane in shape.section.lanes.values():
        if lane.id != 0 and lane.type in DRIVING:
            width = shape.width(lane.id).max()
            if width > WIDEST_LANE:
                raise _fault(document, shape.road, f"<width> makes lane {lane.id} {width:.0f} m wide or more")
            steps = np.abs(np.diff(shape.centre(lane.id), axis=0)).max(initial=0.0)
            if steps > LONGEST_JUMP:
                raise _fault(document, shape.road, f"lane {lane.id} jumps by {steps:.1f} m")


def check_extent(document: Document, shapes: Iterable[SectionShape]) -> None:
    """Raises MapError for roads that are too far apart to be one town; names the one furthest from the middle."""
    every = list(shapes)
    ends = np.array([[(s.x.min(), s.y.min()), (s.x.max(), s.y.max())] for s in every])
    low, high = ends[:, 0].min(0), ends[:, 1].max(0)
    if max(high - low) <= WIDEST:
        return
    away = np.abs(ends - np.median(ends, axis=(0, 1))).max(axis=(1, 2))
    far = every[int(away.argmax())]
    raise _fault(document, far.road, f"<geometry> lies {away.max():,.0f} m from the middle of the town")


def _fault(document: Document, road: Road, what: str) -> MapError:
    return MapError(f"road '{road.id}': {what}", where=document.where, hint=HINT)
