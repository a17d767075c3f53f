"""OpenDRIVE XML to records; every fault is a `MapError` that names the file and the road."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from xml.etree import ElementTree as ET

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.records import Connection, Document, JunctionRecord
from me3bev_plugins.simulator.highway.opendrive.road_reader import RoadReader
from me3bev_plugins.simulator.highway.opendrive.values import HINT, Element, Values


def read_document(source: Path | bytes, name: str) -> Document:
    """Parse OpenDRIVE, plain or gzipped, from a path or from bytes.

    Raises:
        MapError: the file is missing, empty, damaged, not OpenDRIVE, or has no road.
    """
    where = str(source) if isinstance(source, Path) else name
    root = _root(_load(source, where), where)
    document = Document(name)
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


def _load(source: Path | bytes, where: str) -> bytes:
    try:
        data = source.read_bytes() if isinstance(source, Path) else source
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
    except (EOFError, zlib.error, gzip.BadGzipFile) as fault:
        raise MapError(f"the compressed file is damaged ({fault})", where=where, hint="Copy it again") from fault
    except OSError as fault:
        raise MapError(
            f"cannot be read ({fault.strerror or fault})", where=where, hint="Give the path of an .xodr file"
        ) from fault
    if not data.strip():
        raise MapError("the file is empty", where=where, hint="Give an OpenDRIVE file (.xodr or .xodr.gz)")
    return data


def _root(data: bytes, where: str) -> Element:
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, ValueError, LookupError) as fault:
        hint = "It may be truncated: copy it again"
        raise MapError(f"is not well-formed XML ({fault})", where=where, hint=hint) from fault
    for element in root.iter():  # Some exporters put everything in a namespace.
        if isinstance(element.tag, str) and element.tag.startswith("{"):
            element.tag = element.tag.rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise MapError(
            f"the outermost element is <{root.tag}>",
            where=where,
            allowed="<OpenDRIVE>",
            hint="Give an OpenDRIVE file (.xodr or .xodr.gz)",
        )
    return root


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
