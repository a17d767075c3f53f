"""OpenDRIVE XML to records; every fault is a `MapError` that names the file and the road."""

from __future__ import annotations

from pathlib import Path

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.bounds import HINT
from me3bev_plugins.simulator.highway.opendrive.records import Connection, Document, JunctionRecord
from me3bev_plugins.simulator.highway.opendrive.road_reader import RoadReader
from me3bev_plugins.simulator.highway.opendrive.source import parse, read_file, unpacked
from me3bev_plugins.simulator.highway.opendrive.values import Element, Values


def read_document(source: Path | bytes, name: str, where: str | None = None) -> Document:
    """Parse OpenDRIVE, plain or gzipped, from a path or from bytes.

    Args:
        where: what errors call the file; by default its path, or the name when there is none.

    Raises:
        MapError: the file is missing, empty, damaged, too large, not OpenDRIVE, or has no road.
    """
    where = where or (str(source) if isinstance(source, Path) else name)
    data = read_file(source) if isinstance(source, Path) else unpacked(source, where)
    root = parse(data, where)
    document = Document(name, where)
    for element in root.findall("road"):
        road = RoadReader(element, where).road()
        if road.id in document.roads:
            raise MapError(f"two roads have the id '{road.id}'", where=where, hint=HINT)
        document.roads[road.id] = road
    for element in root.findall("junction"):
        junction = _junction(element, where)
        document.junctions[junction.id] = junction
    if not document.roads:
        raise MapError("the file has no <road>", where=where, hint=HINT)
    return document


def _junction(element: Element, where: str) -> JunctionRecord:
    read = Values(f"junction '{element.get('id')}'", where)
    connections = []
    for entry in element.findall("connection"):
        connecting = entry.get("connectingRoad") or entry.get("linkedRoad")
        incoming = entry.get("incomingRoad")
        if connecting is None or incoming is None:
            continue  # Direct or virtual connections carry no road of their own.
        links = tuple((read.whole(link, "from"), read.whole(link, "to")) for link in entry.findall("laneLink"))
        connections.append(Connection(incoming, connecting, read.contact(entry), links))
    return JunctionRecord(read.text(element, "id"), tuple(connections))
