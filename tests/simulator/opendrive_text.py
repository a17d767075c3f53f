"""Small OpenDRIVE documents, written by hand: a ring road, and three streets that meet."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, pi, sin

WIDTH = 3.5


def geometry(s: float, x: float, y: float, heading: float, length: float, curve: str) -> str:
    """One <geometry>."""
    return f'<geometry s="{s}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{curve}</geometry>'


def lane(
    number: int, kind: str = "driving", width: float = WIDTH, before: int = 0, after: int = 0, mark: str = ""
) -> str:
    """One <lane>; `before` and `after` are its links, 0 for none."""
    link = (f'<predecessor id="{before}"/>' if before else "") + (f'<successor id="{after}"/>' if after else "")
    return (
        f'<lane id="{number}" type="{kind}"><link>{link}</link>'
        f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>{mark}</lane>'
    )


@dataclass
class RoadText:
    """The text of one <road>."""

    id: str
    plan: str
    length: float
    left: str = ""
    right: str = ""
    junction: str = "-1"
    before: str = ""
    after: str = ""
    offset: float = 0.0
    height: float = 0.0
    speed: str = '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
    signals: str = ""
    objects: str = ""
    sections: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        sections = self.sections or [
            f'<laneSection s="0"><left>{self.left}</left><center><lane id="0" type="none"/></center>'
            f"<right>{self.right}</right></laneSection>"
        ]
        return (
            f'<road id="{self.id}" length="{self.length}" junction="{self.junction}">'
            f"<link>{self.before}{self.after}</link>{self.speed}<planView>{self.plan}</planView>"
            f'<elevationProfile><elevation s="0" a="{self.height}" b="0" c="0" d="0"/></elevationProfile>'
            f'<lanes><laneOffset s="0" a="{self.offset}" b="0" c="0" d="0"/>{"".join(sections)}</lanes>'
            f"<objects>{self.objects}</objects><signals>{self.signals}</signals></road>"
        )


def to_road(tag: str, road: str, contact: str) -> str:
    """A road's link to another road."""
    return f'<{tag} elementType="road" elementId="{road}" contactPoint="{contact}"/>'


def document(*parts: object) -> bytes:
    """A whole file."""
    return ("<OpenDRIVE><header/>" + "".join(map(str, parts)) + "</OpenDRIVE>").encode()


def ring(radius: float = 30.0, straight: float = 40.0, **changes: object) -> list[RoadText]:
    """A stadium of two roads, each a straight and a half circle to the left, two lanes round and one against."""
    roads = []
    for index in range(2):
        heading = index * pi
        x, y = (-straight / 2, -radius) if index == 0 else (straight / 2, radius)
        bend = pi * radius
        plan = geometry(0, x, y, heading, straight, "<line/>") + geometry(
            straight, -x, y, heading, bend, f'<arc curvature="{1 / radius}"/>'
        )
        other = str(2 - index)
        roads.append(
            RoadText(
                id=str(index + 1),
                plan=plan,
                length=straight + bend,
                left=lane(1, before=1, after=1),
                right=lane(-1, before=-1, after=-1, mark='<roadMark sOffset="0" type="broken" color="white"/>')
                + lane(-2, before=-2, after=-2, mark='<roadMark sOffset="0" type="solid" color="white"/>'),
                before=to_road("predecessor", other, "end"),
                after=to_road("successor", other, "start"),
                **changes,  # type: ignore[arg-type]
            )
        )
    return roads


ARMS = {"1": pi, "2": 0.0, "3": -pi / 2}
"""Bearing of each street of `streets` from the junction's middle: west, east, south."""
MOUTH, FAR = 12.0, 92.0
"""Metres from the middle at which a street begins and ends."""


def _street(name: str, sides: str) -> list[RoadText]:
    """A two-way street towards the middle, and the turning loop at its far end."""
    bearing = ARMS[name]
    x, y = FAR * cos(bearing), FAR * sin(bearing)
    inward = bearing + pi
    walk = {n: lane(n, "sidewalk", 2.0) if sides == "sidewalk" else "" for n in (2, -2)}
    street = RoadText(
        id=name,
        plan=geometry(0, x, y, inward, FAR - MOUTH, "<line/>"),
        length=FAR - MOUTH,
        left=walk[2] + lane(1, before=-1),
        right=lane(-1, before=-1) + walk[-2],
        before=to_road("predecessor", f"{name}9", "end"),
        after='<successor elementType="junction" elementId="7"/>',
    )
    # Out on lane 1, half a circle to the right round the end of the street, back on lane -1.
    out = WIDTH / 2
    loop = RoadText(
        id=f"{name}9",
        plan=geometry(
            0, x - out * sin(inward), y + out * cos(inward), bearing, pi * out, f'<arc curvature="{1 / out}"/>'
        ),
        length=pi * out,
        right=lane(-1, before=1, after=-1),
        offset=WIDTH / 2,
        before=to_road("predecessor", name, "start"),
        after=to_road("successor", name, "start"),
    )
    return [street, loop]


def _connector(source: str, target: str) -> RoadText:
    """A curve from one street's lane -1 to another's lane 1, as a cubic with tangents at both ends."""
    a, b = ARMS[source], ARMS[target]
    heading, exit_heading = a + pi, b
    start = (MOUTH * cos(a) + WIDTH / 2 * sin(heading), MOUTH * sin(a) - WIDTH / 2 * cos(heading))
    end = (MOUTH * cos(b) + WIDTH / 2 * sin(b), MOUTH * sin(b) - WIDTH / 2 * cos(b))
    dx, dy = end[0] - start[0], end[1] - start[1]
    u, v = dx * cos(heading) + dy * sin(heading), -dx * sin(heading) + dy * cos(heading)
    pull = 1.5 * (u * u + v * v) ** 0.5
    turn = exit_heading - heading
    tu, tv = pull * cos(turn), pull * sin(turn)
    numbers = {
        "aU": 0.0, "bU": pull, "cU": 3 * u - 2 * pull - tu, "dU": pull + tu - 2 * u,
        "aV": 0.0, "bV": 0.0, "cV": 3 * v - tv, "dV": tv - 2 * v,
    }  # fmt: skip
    curve = "<paramPoly3 " + " ".join(f'{k}="{n}"' for k, n in numbers.items()) + ' pRange="normalized"/>'
    length = _arc_length(numbers)
    return RoadText(
        id=f"{source}0{target}",
        plan=geometry(0, *start, heading, length, curve),
        length=length,
        junction="7",
        right=lane(-1, before=-1, after=1),
        offset=WIDTH / 2,
        before=to_road("predecessor", source, "end"),
        after=to_road("successor", target, "end"),
        speed="",
    )


def _arc_length(c: dict[str, float], pieces: int = 1000) -> float:
    def at(p: float) -> tuple[float, float]:
        return tuple(sum(c[k + axis] * p**n for n, k in enumerate("abcd")) for axis in "UV")  # type: ignore[return-value]

    points = [at(i / pieces) for i in range(pieces + 1)]
    return sum(((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) ** 0.5 for a, b in pairwise(points))


def streets(sides: str = "") -> tuple[dict[str, RoadText], str]:
    """Roads by id, and the junction "7", of three two-way streets that meet in a T; `sides` may be "sidewalk"."""
    roads = [road for name in ARMS for road in _street(name, sides)]
    pairs = [(a, b) for a in ARMS for b in ARMS if a != b]
    roads += [_connector(a, b) for a, b in pairs]
    connections = "".join(
        f'<connection id="{i}" incomingRoad="{a}" connectingRoad="{a}0{b}" contactPoint="start">'
        f'<laneLink from="-1" to="-1"/></connection>'
        for i, (a, b) in enumerate(pairs)
    )
    return {road.id: road for road in roads}, f'<junction id="7">{connections}</junction>'


def stadium(**changes: object) -> bytes:
    """The ring road as a file."""
    return document(*ring(**changes))  # type: ignore[arg-type]


def tee(sides: str = "", **changes: dict[str, object]) -> bytes:
    """The three streets as a file; keywords name a road ("r3") and what to set on it."""
    roads, junction = streets(sides)
    for name, values in changes.items():
        for key, value in values.items():
            setattr(roads[name.removeprefix("r")], key, value)
    return document(*roads.values(), junction)
