"""One <road> element to its record."""

from __future__ import annotations

import math
from typing import cast

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.geometry import PARAMETERS, Curve, Piece, ReferenceLine
from me3bev_plugins.simulator.highway.opendrive.records import (
    LaneRecord,
    ObjectRecord,
    Road,
    RoadLink,
    Section,
    SignalRecord,
)
from me3bev_plugins.simulator.highway.opendrive.values import Element, Values

LONGEST = 100_000.0
"""Metres; a longer road is a fault of the file, not a road."""
SHARPEST = 100.0
"""1/m; a sharper curve is a fault of the file."""
FASTEST = 150.0
"""m/s; a higher limit is a fault of the file."""
UNITS = {"mph": 0.44704, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "m/s": 1.0}


class RoadReader:
    """One <road> element."""

    def __init__(self, element: Element, where: str) -> None:
        self.values = Values(f"road '{element.get('id')}'", where)
        self.element = element

    def road(self) -> Road:
        """The record.

        Raises:
            MapError: something is missing or is not a number, a curve is unknown, or traffic drives on the left.
        """
        element = self.element
        if element.get("rule", "RHT") == "LHT":
            raise MapError(
                f"{self.values.owner}: traffic drives on the left",
                where=self.values.where,
                allowed="right-hand traffic (rule='RHT')",
            )
        length = self.values.number(element, "length")
        if not 0.0 <= length <= LONGEST:
            raise self.values.fault(f"length='{element.get('length')}' is out of range")
        link = element.find("link")
        junction = element.get("junction", "-1")
        return Road(
            id=self.values.text(element, "id"),
            length=length,
            junction=None if junction in ("-1", "") else junction,
            line=self.line(),
            elevation=self.values.cubics(element.findall("elevationProfile/elevation")),
            offset=self.values.cubics(element.findall("lanes/laneOffset")),
            sections=self.sections(length),
            predecessor=self.link(link, "predecessor"),
            successor=self.link(link, "successor"),
            limits=self.limits(),
            signals=self.signals(),
            objects=tuple(self.object(entry) for entry in element.findall("objects/object")),
        )

    def link(self, parent: Element | None, tag: str) -> RoadLink | None:
        """What one end of the road leads to."""
        element = parent.find(tag) if parent is not None else None
        if element is None or element.get("elementId") is None:
            return None
        kind = element.get("elementType", "road")
        if kind not in ("road", "junction"):
            raise self.values.fault(f"<{tag}> elementType='{kind}' is neither 'road' nor 'junction'")
        target = self.values.text(element, "elementId")
        return RoadLink("road" if kind == "road" else "junction", target, self.values.contact(element))

    def line(self) -> ReferenceLine:
        """The plan view."""
        pieces = []
        for element in self.element.findall("planView/geometry"):
            curve = next((child for child in element if child.tag in PARAMETERS), None)
            if curve is None:
                names = ", ".join(child.tag for child in element) or "nothing"
                raise self.values.fault(f"<geometry> holds {names}, not one of {', '.join(PARAMETERS)}")
            s, x, y, heading, length = (self.values.number(element, key) for key in ("s", "x", "y", "hdg", "length"))
            if not 0.0 <= length <= LONGEST:
                raise self.values.fault(f"<geometry> length='{element.get('length')}' is out of range")
            pieces.append(Piece(s, x, y, heading, length, cast(Curve, curve.tag), self.curve(curve, length)))
        if not pieces:
            raise self.values.fault("has no <planView> with a <geometry>")
        return ReferenceLine(tuple(sorted(pieces, key=lambda piece: piece.s)))

    def curvature(self, element: Element, key: str) -> float:
        """A curvature that a road could have."""
        value = self.values.number(element, key)
        if abs(value) > SHARPEST:
            raise self.values.fault(f"<{element.tag}> {key}='{element.get(key)}' is out of range")
        return value

    def curve(self, element: Element, length: float) -> tuple[float, ...]:
        """The values of one curve, in the order that `Piece` takes them."""
        if element.tag == "arc":
            return (self.curvature(element, "curvature"),)
        if element.tag == "spiral":
            return self.curvature(element, "curvStart"), self.curvature(element, "curvEnd")
        if element.tag == "poly3":
            return tuple(self.values.number(element, letter) for letter in "abcd")
        if element.tag == "paramPoly3":
            keys = [letter + axis for axis in "UV" for letter in "abcd"]
            last = length if element.get("pRange") == "arcLength" else 1.0
            return (*(self.values.number(element, key) for key in keys), last)
        return ()

    def limits(self) -> tuple[tuple[float, float], ...]:
        """(s, m/s) of each <type> with a speed."""
        found = []
        for element in self.element.findall("type"):
            speed = element.find("speed")
            top = speed.get("max") if speed is not None else None
            if speed is None or top in (None, "no limit", "undefined"):
                continue
            unit = speed.get("unit") or "m/s"
            if unit not in UNITS:
                raise self.values.fault(f"<speed> unit='{unit}' is not one of {', '.join(UNITS)}")
            value = self.values.number(speed, "max") * UNITS[unit]
            if value > FASTEST:
                raise self.values.fault(f"<speed> max='{top}' is out of range")
            if value > 0:
                found.append((self.values.number(element, "s", 0.0), value))
        return tuple(sorted(found))

    def sections(self, length: float) -> tuple[Section, ...]:
        """Lane sections in order of s."""
        elements = self.element.findall("lanes/laneSection")
        if not elements:
            raise self.values.fault("has no <laneSection>")
        starts = [min(max(self.values.number(element, "s"), 0.0), length) for element in elements]
        order = sorted(range(len(elements)), key=starts.__getitem__)
        ends = [starts[i] for i in order[1:]] + [length]
        return tuple(
            Section(starts[i], end, {lane.id: lane for lane in map(self.lane, elements[i].iter("lane"))})
            for i, end in zip(order, ends, strict=True)
        )

    def lane(self, element: Element) -> LaneRecord:
        """One lane of a section."""
        link = element.find("link")
        near, far = (
            tuple(self.values.whole(entry, "id") for entry in (link.findall(tag) if link is not None else ()))
            for tag in ("predecessor", "successor")
        )
        return LaneRecord(
            id=self.values.whole(element, "id"),
            type=element.get("type", "none"),
            width=self.values.cubics(element.findall("width"), "sOffset"),
            predecessors=near,
            successors=far,
            marks=tuple(
                (self.values.number(mark, "sOffset", 0.0), mark.get("type", "none"), mark.get("color", "standard"))
                for mark in element.findall("roadMark")
            ),
        )

    def signals(self) -> tuple[SignalRecord, ...]:
        """Signals, signs and references to them."""
        found = []
        for element in self.element.findall("signals/*"):
            if element.tag not in ("signal", "signalReference"):
                continue
            lanes = tuple(
                (min(pair), max(pair))
                for entry in element.findall("validity")
                if (pair := (self.values.whole(entry, "fromLane"), self.values.whole(entry, "toLane"))) != (0, 0)
            )
            found.append(
                SignalRecord(
                    id=self.values.text(element, "id"),
                    s=self.values.number(element, "s"),
                    t=self.values.number(element, "t", 0.0),
                    orientation=element.get("orientation", "none"),
                    type=element.get("type", ""),
                    value=self.values.number(element, "value") if _is_number(element.get("value")) else None,
                    unit=element.get("unit", ""),
                    lanes=lanes,
                    reference=element.tag == "signalReference",
                )
            )
        return tuple(found)

    def object(self, element: Element) -> ObjectRecord:
        """One object with its outline."""
        return ObjectRecord(
            type=element.get("type", ""),
            name=element.get("name", ""),
            s=self.values.number(element, "s", 0.0),
            t=self.values.number(element, "t", 0.0),
            heading=self.values.number(element, "hdg", 0.0),
            length=self.values.number(element, "length", 0.0),
            width=self.values.number(element, "width", 0.0),
            z=self.values.number(element, "zOffset", 0.0),
            corners=tuple(
                (self.values.number(c, "u"), self.values.number(c, "v")) for c in element.iter("cornerLocal")
            ),
        )


def _is_number(text: str | None) -> bool:
    try:
        return text is not None and math.isfinite(float(text))
    except ValueError:
        return False
