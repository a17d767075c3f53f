"""Attributes of XML elements as checked values; a fault names the file and the road or junction it belongs to."""

from __future__ import annotations

import math
from typing import cast
from xml.etree import ElementTree as ET

import numpy as np

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive.bounds import HINT
from me3bev_plugins.simulator.highway.opendrive.geometry import ZERO, Cubics
from me3bev_plugins.simulator.highway.opendrive.records import Contact

Element = ET.Element


class Values:
    """Attributes of elements, with errors that say whose they are."""

    def __init__(self, owner: str, where: str) -> None:
        self.owner = owner
        self.where = where

    def fault(self, what: str) -> MapError:
        """The error for a fault of this road or junction."""
        return MapError(f"{self.owner}: {what}", where=self.where, hint=HINT)

    def text(self, element: Element, key: str) -> str:
        """A required attribute."""
        value = element.get(key)
        if value is None:
            raise self.fault(f"<{element.tag}> has no '{key}'")
        return value

    def number(self, element: Element, key: str, default: float | None = None) -> float:
        """A finite number; required unless a default is given."""
        value = element.get(key)
        if value is None or value == "":
            if default is None:
                raise self.fault(f"<{element.tag}> has no '{key}'")
            return default
        try:
            number = float(value)
        except ValueError:
            raise self.fault(f"<{element.tag}> {key}='{value}' is not a number") from None
        if not math.isfinite(number) or abs(number) > 1e9:
            raise self.fault(f"<{element.tag}> {key}='{value}' is out of range")
        return number

    def whole(self, element: Element, key: str) -> int:
        """A required whole number."""
        value = self.number(element, key)
        if value != int(value):
            raise self.fault(f"<{element.tag}> {key}='{element.get(key)}' is not a whole number")
        return int(value)

    def contact(self, element: Element) -> Contact:
        """A contact point; 'start' where the file leaves it out, as it does towards junctions."""
        value = element.get("contactPoint") or "start"
        if value not in ("start", "end"):
            raise self.fault(f"<{element.tag}> contactPoint='{value}' is neither 'start' nor 'end'")
        return cast(Contact, value)

    def cubics(self, elements: list[Element], key: str = "s") -> Cubics:
        """Piecewise cubics from elements with a, b, c, d; zero when there are none."""
        if not elements:
            return ZERO
        rows = sorted((self.number(e, key, 0.0), *(self.number(e, letter, 0.0) for letter in "abcd")) for e in elements)
        table = np.array(rows)
        return Cubics(table[:, 0].copy(), np.ascontiguousarray(table[:, 1:]))
