"""What an OpenDRIVE file says, as typed records. Units: metres, radians, m/s."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from me3bev_plugins.simulator.highway.opendrive.geometry import Cubics, ReferenceLine

DRIVING = frozenset(
    {"driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "mwyEntry", "mwyExit", "slipLane"}
)
"""Lane types that become lanes of the town."""
PAVED = DRIVING | {"bidirectional", "shoulder", "parking", "border", "stop", "biking", "restricted", "special1"}
"""Lane types that are drawn as asphalt."""
WALKING = frozenset({"sidewalk", "walking"})
"""Lane types that pedestrians walk on."""

Contact = Literal["start", "end"]


@dataclass(frozen=True)
class RoadLink:
    """Where one end of a road leads."""

    kind: Literal["road", "junction"]
    id: str
    contact: Contact


@dataclass(frozen=True, eq=False)
class LaneRecord:
    """One lane of a lane section; `marks` are (s offset, type, colour) of its outer line."""

    id: int
    type: str
    width: Cubics
    predecessors: tuple[int, ...] = ()
    successors: tuple[int, ...] = ()
    marks: tuple[tuple[float, str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Section:
    """A lane section from `start` to `end` (s); `lanes` by id: positive on the left, the centre line is 0."""

    start: float
    end: float
    lanes: dict[int, LaneRecord]

    @property
    def length(self) -> float:
        """Metres along the reference line."""
        return self.end - self.start

    def side(self, sign: int) -> list[LaneRecord]:
        """Lanes of one side (+1 left, -1 right), from the middle outwards."""
        return [self.lanes[i] for i in sorted(self.lanes, key=abs) if i * sign > 0]


@dataclass(frozen=True)
class SignalRecord:
    """A signal or sign, or a reference to one, as it stands on a road; `lanes` empty when no lane is named."""

    id: str
    s: float
    t: float
    orientation: str
    type: str = ""
    value: float | None = None
    unit: str = ""
    lanes: tuple[tuple[int, int], ...] = ()
    reference: bool = False

    def covers(self, lane: int) -> bool:
        """Whether one of the named ranges holds the lane."""
        return any(low <= lane <= high for low, high in self.lanes)


@dataclass(frozen=True)
class ObjectRecord:
    """An object on a road; `corners` are (u, v) in its own frame, `z` is its height above the road."""

    type: str
    name: str
    s: float
    t: float
    heading: float
    length: float
    width: float
    z: float = 0.0
    corners: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Road:
    """One road with everything on it; `limits` are (s, m/s) of its types."""

    id: str
    length: float
    junction: str | None
    line: ReferenceLine
    elevation: Cubics
    offset: Cubics
    sections: tuple[Section, ...]
    predecessor: RoadLink | None = None
    successor: RoadLink | None = None
    limits: tuple[tuple[float, float], ...] = ()
    signals: tuple[SignalRecord, ...] = ()
    objects: tuple[ObjectRecord, ...] = ()

    def limit(self, s: float) -> float | None:
        """Nominal speed limit at s, m/s, or None when the file gives none."""
        at = [value for start, value in self.limits if start <= s + 1e-6]
        return at[-1] if at else None


@dataclass(frozen=True)
class Connection:
    """One connection of a junction: lane links are (from incoming, to connecting)."""

    incoming: str
    connecting: str
    contact: Contact
    links: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class JunctionRecord:
    """A junction element."""

    id: str
    connections: tuple[Connection, ...]


@dataclass(frozen=True, eq=False)
class Document:
    """A whole file; ids are those of the file. Errors call it `where`."""

    name: str
    where: str
    roads: dict[str, Road] = field(default_factory=dict)
    junctions: dict[str, JunctionRecord] = field(default_factory=dict)


def is_driven(road: Road) -> bool:
    """Whether a road has any driving lane; exports hold roads of grass and kerbs too."""
    return any(lane.type in DRIVING for section in road.sections for lane in section.lanes.values())
