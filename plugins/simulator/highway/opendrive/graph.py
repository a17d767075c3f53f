"""Which driving lanes lead to which, in driving direction."""

from __future__ import annotations

from collections.abc import Iterator

from me3bev_plugins.simulator.highway.opendrive.records import DRIVING, Contact, Document, Road, RoadLink
from me3bev_plugins.simulator.highway.opendrive.shapes import Key

Links = dict[Key, list[Key]]


def driving_lanes(document: Document) -> Iterator[Key]:
    """Every lane of a driving type, section by section."""
    for road in document.roads.values():
        for index, section in enumerate(road.sections):
            for lane in section.lanes.values():
                if lane.id != 0 and lane.type in DRIVING:
                    yield road.id, index, lane.id


def lane_links(document: Document) -> Links:
    """Successors of every driving lane; links that would reverse the direction of travel are left out."""
    links: Links = {key: [] for key in driving_lanes(document)}

    def add(source: Key | None, target: Key | None) -> None:
        if source in links and target in links and target not in links[source]:
            links[source].append(target)

    for road_id, index, lane in list(links):
        key = (road_id, index, lane)
        for neighbour in _along(document, key, ahead=True):
            add(key, neighbour)
        for neighbour in _along(document, key, ahead=False):
            add(neighbour, key)
    for junction in document.junctions.values():
        for connection in junction.connections:
            source = document.roads.get(connection.incoming)
            target = document.roads.get(connection.connecting)
            if source is None or target is None:
                continue
            for first, second in connection.links:
                index = len(source.sections) - 1 if first < 0 else 0
                add((source.id, index, first), _entering(target, connection.contact, second))
    return links


def _along(document: Document, key: Key, *, ahead: bool) -> Iterator[Key]:
    """Lanes that the lane's own link and its road's link name, ahead of it or behind it."""
    road_id, index, lane = key
    road = document.roads[road_id]
    record = road.sections[index].lanes[lane]
    up = (lane < 0) == ahead  # Towards larger s.
    named = record.successors if up else record.predecessors
    following = index + 1 if up else index - 1
    if 0 <= following < len(road.sections):
        for other in named:
            if (other < 0) == (lane < 0):
                yield road_id, following, other
        return
    link: RoadLink | None = road.successor if up else road.predecessor
    target = document.roads.get(link.id) if link is not None and link.kind == "road" else None
    if link is None or target is None:
        return
    for other in named:
        found = _entering(target, link.contact, other) if ahead else _leaving(target, link.contact, other)
        if found is not None:
            yield found


def _entering(road: Road, contact: Contact, lane: int) -> Key | None:
    """The lane's end at the contact point if traffic enters the road there."""
    if (contact == "start") != (lane < 0):
        return None
    return road.id, 0 if contact == "start" else len(road.sections) - 1, lane


def _leaving(road: Road, contact: Contact, lane: int) -> Key | None:
    """The lane's end at the contact point if traffic leaves the road there."""
    if (contact == "end") != (lane < 0):
        return None
    return road.id, 0 if contact == "start" else len(road.sections) - 1, lane
