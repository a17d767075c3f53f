"""OpenDRIVE files as towns: `read_town` reads a user's map and the built-in ones alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from me3bev_plugins.simulator.highway.opendrive.control import place_signals, place_signs, settle_control
from me3bev_plugins.simulator.highway.opendrive.crosswalks import find_crosswalks
from me3bev_plugins.simulator.highway.opendrive.document import read_document
from me3bev_plugins.simulator.highway.opendrive.footprint import Footprint, rectangle
from me3bev_plugins.simulator.highway.opendrive.junctions import Crossing, find_crossings
from me3bev_plugins.simulator.highway.opendrive.lanes import Network, build_network
from me3bev_plugins.simulator.highway.opendrive.limits import assign_limits
from me3bev_plugins.simulator.highway.opendrive.roadside import find_roadsides
from me3bev_plugins.simulator.highway.opendrive.scenery import grow_scenery
from me3bev_plugins.simulator.highway.opendrive.shapes import section_shapes
from me3bev_plugins.simulator.highway.opendrive.sidewalks import find_sidewalks
from me3bev_plugins.simulator.highway.opendrive.source import read_file
from me3bev_plugins.simulator.highway.opendrive.surfaces import find_surfaces
from me3bev_plugins.simulator.highway.town import Floats, Junction, Lane, Town

__all__ = ["read_file", "read_town"]

WORTH_SAYING = 5.0
"""Metres of lanes left out that a description mentions."""


def read_town(source: Path | bytes, name: str, where: str | None = None) -> Town:
    """A town from an OpenDRIVE file, plain or gzipped.

    Args:
        source: path of the file, or its bytes.
        name: of the town; scenery grows from it, so the same name gives the same houses.
        where: what errors call the file; by default its path, or the name when there is none.

    Raises:
        MapError: the file cannot be read, is damaged, or holds no closed course.
    """
    document = read_document(source, name, where)
    shapes = section_shapes(document)
    network = build_network(document, shapes)
    assign_limits(document, network)
    crossings = find_crossings(network)
    kinds = settle_control(document, network, crossings)
    lanes = _lanes(network, crossings)
    surfaces = find_surfaces(shapes, network, crossings)
    signals, signs = place_signals(network, crossings), place_signs(network, crossings, kinds)
    crosswalks = find_crosswalks(document, shapes, network, crossings)
    ground = Footprint(*_extent(lanes))
    ground.add_lanes(lanes)
    ground.add_polygons(surfaces)
    sidewalks = find_sidewalks(shapes, network, ground)
    for walk in sidewalks:
        ground.add_line(walk.points, walk.width)
    ground.add_polygons(crosswalk.corners for crosswalk in crosswalks)
    for post in (*signals, *signs):
        ground.add_polygons([rectangle(np.array(post.position[:2]), (2.0, 2.0), 0.0)])
    buildings, props = grow_scenery(name, find_roadsides(document, shapes), ground)
    return Town(
        name=name,
        lanes=lanes,
        junctions=_junctions(crossings),
        signals=signals,
        signs=signs,
        crosswalks=crosswalks,
        sidewalks=sidewalks,
        buildings=buildings,
        props=props,
        description=_description(lanes, crossings, network.left_out),
        surfaces=surfaces,
    )


def _extent(lanes: tuple[Lane, ...]) -> tuple[Floats, Floats]:
    points = np.concatenate([lane.points[:, :2] for lane in lanes])
    return points.min(0), points.max(0)


def _description(lanes: tuple[Lane, ...], crossings: list[Crossing], left_out: float) -> str:
    metres = sum(lane.length for lane in lanes)
    lit = sum(crossing.control == "signal" for crossing in crossings)
    text = f"{metres / 1000:.1f} km of lanes, {len(crossings)} junctions, {lit} with traffic lights"
    if left_out < WORTH_SAYING:
        return text
    return f"{text}; {left_out / 1000:.2f} km left out: dead ends, or apart from the rest"


def _lanes(network: Network, crossings: list[Crossing]) -> tuple[Lane, ...]:
    number = {crossing.name: index for index, crossing in enumerate(crossings)}
    return tuple(
        Lane(
            id=index,
            points=draft.points,
            width=draft.width,
            limit=draft.limit,
            successors=tuple(draft.successors),
            predecessors=tuple(draft.predecessors),
            left=draft.left,
            right=draft.right,
            junction=number[draft.junction] if draft.junction is not None else None,
            turn=draft.turn if draft.junction is not None else "straight",
            left_marking=draft.left_marking,
            right_marking=draft.right_marking,
            highway=draft.highway,
        )
        for index, draft in enumerate(network.lanes)
    )


def _junctions(crossings: list[Crossing]) -> tuple[Junction, ...]:
    return tuple(
        Junction(
            id=index,
            connectors=crossing.connectors,
            incoming=crossing.incoming,
            outgoing=crossing.outgoing,
            control=crossing.control,
            arms=len(crossing.arms),
            minor=crossing.minor,
            centre=crossing.centre,
        )
        for index, crossing in enumerate(crossings)
    )
