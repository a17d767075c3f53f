"""A worked-out town as OpenDRIVE 1.6 XML, written with the standard library; the same network gives the same bytes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from itertools import pairwise

from me3bev_plugins.simulator.highway.towns import furniture
from me3bev_plugins.simulator.highway.towns.geometry import TINY, Path
from me3bev_plugins.simulator.highway.towns.network import Connector, Crossroads, Network, Road
from me3bev_plugins.simulator.highway.towns.streets import LaneSpec, Section

DESIGN_SPEED = 105.0
"""km/h."""

Cubic = tuple[float, float, float, float, float]
"""Station and the coefficients a, b, c, d."""


def write(network: Network) -> bytes:
    """The whole town as an OpenDRIVE document."""
    root = ET.Element("OpenDRIVE")
    _add(root, "header", revMajor=1, revMinor=6, name=network.layout.name, version=1)
    for road in network.roads:
        _road(root, road, network.junctions)
    for junction in network.junctions:
        for connector in junction.connectors:
            _connector(root, connector, junction.id)
    for junction in network.junctions:
        furniture.controllers(root, junction)
    for junction in network.junctions:
        _junction(root, junction)
    ET.indent(root, " ")
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def number(value: object) -> str:
    """A float in as few digits as keep a micrometre (a nanometre-scale heading), anything else as it is."""
    if not isinstance(value, float):
        return str(value)
    text = f"{value:.10f}".rstrip("0").rstrip(".")
    return "0" if text in ("", "-0") else text


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {k: number(v) for k, v in attributes.items()})


def _plan(parent: ET.Element, path: Path) -> None:
    plan = _add(parent, "planView")
    for s, piece in zip(path.starts, path.pieces, strict=True):
        geometry = _add(plan, "geometry", s=s, x=piece.x, y=piece.y, hdg=piece.heading, length=piece.length)
        if abs(piece.curvature) < TINY:
            _add(geometry, "line")
        else:
            _add(geometry, "arc", curvature=piece.curvature)


def hermite(s: float, run: float, start: tuple[float, float], end: tuple[float, float]) -> Cubic:
    """The cubic over `run` metres from station `s` with the given values and slopes at its ends."""
    (z0, m0), (z1, m1) = start, end
    rise = (z1 - z0) / run
    return s, z0, m0, (3 * rise - 2 * m0 - m1) / run, (m0 + m1 - 2 * rise) / run**2


def _elevation(parent: ET.Element, cubics: Iterable[Cubic]) -> None:
    profile = _add(parent, "elevationProfile")
    for s, a, b, c, d in cubics:
        _add(profile, "elevation", s=s, a=a, b=b, c=c, d=d)


def _climb(road: Road) -> list[Cubic]:
    """Heights of a road, from knot to knot."""
    street, run = road.street, road.street.path.length
    turns = range(-1, 3) if street.path.closed else range(1)
    knots = {round(s + turn * run, 9) for s, _ in street.heights for turn in turns}
    cuts = [road.low, *sorted(s for s in knots if road.low + 1e-6 < s < road.high - 1e-6), road.high]
    return [hermite(a - road.low, b - a, street.height(a), street.height(b)) for a, b in pairwise(cuts)]


def _road(root: ET.Element, road: Road, junctions: list[Crossroads]) -> None:
    street, section = road.street, road.street.section
    path = street.path.cut(road.low, road.high)
    element = _add(root, "road", name=street.name, length=path.length, id=road.id, junction=-1)
    link = _add(element, "link")
    for tag, (kind, target), contact in (("predecessor", road.before, "end"), ("successor", road.after, "start")):
        extra = {"contactPoint": contact} if kind == "road" else {}
        _add(link, tag, elementType=kind, elementId=target, **extra)
    kind = _add(element, "type", s=0.0, type=street.kind)
    _add(kind, "speed", max=_nominal(road.limit, street.kind), unit="km/h")
    _plan(element, path)
    _elevation(element, _climb(road))
    lanes = _add(element, "lanes")
    _add(lanes, "laneOffset", s=0.0, a=section.middle, b=0.0, c=0.0, d=0.0)
    strips = _add(lanes, "laneSection", s=0.0)
    _strips(strips, road, section)
    furniture.crosswalks(element, road, junctions)
    furniture.signals(element, road, junctions)


def _nominal(limit: float, kind: str) -> float:
    """A road's type speed, km/h: on motorways their design speed, whatever the signs along them post."""
    return max(limit, DESIGN_SPEED) if kind == "motorway" else limit


def _strips(parent: ET.Element, road: Road, section: Section) -> None:
    """The lanes of a road, from left to right, as OpenDRIVE wants them grouped."""
    left = sorted((lane for lane in section.lanes if lane.id > 0), key=lambda lane: -lane.id)
    right = sorted((lane for lane in section.lanes if lane.id < 0), key=lambda lane: -lane.id)
    if left:
        group = _add(parent, "left")
        for lane in left:
            _strip(group, road, lane, section)
    centre = _add(_add(parent, "center"), "lane", id=0, type="none", level="false")
    _mark(centre, *_centre_mark(section))
    group = _add(parent, "right")
    for lane in right:
        _strip(group, road, lane, section)


def _strip(parent: ET.Element, road: Road, lane: LaneSpec, section: Section) -> None:
    element = _add(parent, "lane", id=lane.id, type=lane.kind, level="false")
    link = _add(element, "link")
    if road.before[0] == "road":
        _add(link, "predecessor", id=lane.id)
    if road.after[0] == "road":
        _add(link, "successor", id=lane.id)
    _add(element, "width", sOffset=0.0, a=lane.width, b=0.0, c=0.0, d=0.0)
    _mark(element, *_outer_mark(lane, section))


def _mark(lane: ET.Element, kind: str, colour: str) -> None:
    change = "both" if kind == "broken" and colour == "white" else "none"
    attributes = {} if kind in ("none", "curb") else {"width": 0.125}
    _add(lane, "roadMark", sOffset=0.0, type=kind, material="standard", color=colour, laneChange=change, **attributes)


def _centre_mark(section: Section) -> tuple[str, str]:
    if section.median:
        return "none", "white"
    if section.backward and not section.turn_lane and section.forward + section.backward == 2:
        return "broken", "yellow"
    return "solid", "yellow"


def _outer_mark(lane: LaneSpec, section: Section) -> tuple[str, str]:
    if lane.kind in ("median", "bidirectional"):
        return "solid", "yellow"
    if lane.kind != "driving":
        return ("curb" if lane.kind == "shoulder" and section.sidewalk else "none"), "white"
    last = section.driving(lane.id < 0)[-1] == lane
    return ("solid" if last else "broken"), "white"


def _connector(root: ET.Element, way: Connector, junction: int) -> None:
    path = way.path
    element = _add(root, "road", name="", length=path.length, id=way.id, junction=junction)
    link = _add(element, "link")
    if not way.sidewalk:
        _add(link, "predecessor", elementType="road", elementId=way.source[0], contactPoint=way.source[2])
        _add(link, "successor", elementType="road", elementId=way.target[0], contactPoint=way.target[2])
        kind = _add(element, "type", s=0.0, type=way.kind)
        _add(kind, "speed", max=_nominal(way.limit, way.kind), unit="km/h")
    _plan(element, path)
    z0, slope0, z1, slope1 = way.heights
    _elevation(element, [hermite(0.0, path.length, (z0, slope0), (z1, slope1))])
    lanes = _add(element, "lanes")
    _add(lanes, "laneOffset", s=0.0, a=way.width / 2, b=0.0, c=0.0, d=0.0)
    section = _add(lanes, "laneSection", s=0.0)
    _mark(_add(_add(section, "center"), "lane", id=0, type="none", level="false"), "none", "white")
    kind_of = "sidewalk" if way.sidewalk else "driving"
    lane = _add(_add(section, "right"), "lane", id=-1, type=kind_of, level="false")
    if not way.sidewalk:
        ends = _add(lane, "link")
        _add(ends, "predecessor", id=way.source[1])
        _add(ends, "successor", id=way.target[1])
    _add(lane, "width", sOffset=0.0, a=way.width, b=0.0, c=0.0, d=0.0)
    _mark(lane, "none", "white")


def _junction(root: ET.Element, junction: Crossroads) -> None:
    element = _add(root, "junction", id=junction.id, name=junction.node.name)
    driven = [way for way in junction.connectors if not way.sidewalk]
    for index, way in enumerate(driven):
        connection = _add(
            element,
            "connection",
            id=index,
            incomingRoad=way.source[0],
            connectingRoad=way.id,
            contactPoint="start",
        )
        _add(connection, "laneLink", **{"from": way.source[1], "to": -1})
    furniture.controller_links(element, junction)
