"""T4: a figure-eight motorway that crosses over itself, with four loop ramps and two country links, and a small
grid of slow streets inside its upper lobe."""

from __future__ import annotations

import math

from me3bev_plugins.simulator.highway.towns.geometry import Path, Pose, arcs, beside, polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

MOTORWAY = Section(4, 0, shoulder=2.0, sidewalk=0)
RAMP, LINK = (Section(n, 0, shoulder=1.0, sidewalk=0) for n in (1, 2))
STREET = Section(1, 1, shoulder=0.5)
SLIP = Section(1, 0, shoulder=0.5)
HALF = 11.0
"""From the middle of the motorway to the middle of a carriageway."""
OUTER = 5.25
"""From the middle of a carriageway to the middle of its outermost lane."""
EAST, WEST, NORTH, SOUTH, LEG = 398.0, -500.0, 382.0, -422.0, -22.0
DECK = 11.0
LOOP = 52.0


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T4", "figure-eight motorway with loop ramps and a small grid", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    eight = polyline(
        (0, SOUTH, 190),
        (0, NORTH, 165),
        (EAST, NORTH, 150),
        (EAST, LEG, 62),
        (WEST, LEG, 75),
        (WEST, SOUTH, 165),
        closed=True,
    )
    slow = (((EAST - 70, LEG), 60.0), ((WEST + 115, LEG), 90.0))
    back = (((WEST + 115, LEG), 60.0), ((EAST - 70, LEG), 90.0))
    deck = tuple(((x, LEG), z) for x, z in ((330.0, 0.0), (95.0, DECK), (-95.0, DECK), (-330.0, 0.0)))
    return (
        Street("onward", eight.offset(-HALF), MOTORWAY, 90, zones=slow, climbs=deck, kind="motorway"),
        Street("back", eight.offset(HALF).reversed(), MOTORWAY, 90, zones=back, climbs=deck, kind="motorway"),
        *_loops(),
        Street("south link", _south_link(), LINK, 60, kind="rural"),
        Street("north link", _north_link(), RAMP, 60, kind="rural"),
        Street("long street", polyline((HALF, 172), (EAST - HALF, 172)), STREET, 30),
        Street(
            "outer street",
            polyline((60, 172), (60, 310, 85), (312, 310, 30), (312, 68, 22), (EAST - HALF, 68)),
            STREET,
            30,
        ),
        Street(
            "inner street",
            polyline((130, 172), (130, 248, 60), (352, 248, 18), (352, 120, 18), (200, 120, 34), (200, NORTH - HALF)),
            STREET,
            30,
        ),
        Street("short street", polyline((255, 310), (255, 120)), STREET, 30),
        Street("slip", polyline((104, 172), (74.5, 189, 30), (60, 214)), SLIP, 30),
    )


def _loops() -> tuple[Street, ...]:
    """Ramps that turn left by looping right over three quarters of a circle, one in each quarter."""
    gap = HALF + OUTER
    starts: tuple[tuple[str, Pose, bool], ...] = (
        ("north to west", (gap, LEG + gap, math.pi / 2), True),
        ("west to south", (-gap, LEG + gap, math.pi), False),
        ("south to east", (-gap, LEG - gap, -math.pi / 2), True),
        ("east to north", (gap, LEG - gap, 0.0), False),
    )
    out = []
    for name, corner, up in starts:
        path = arcs(beside(corner, 0.0, 12.0), (LOOP - 12, 0), (1.5 * math.pi * LOOP, -LOOP), (LOOP - 12, 0))
        low, high = (path.pose(path.length * share)[:2] for share in (0.28, 0.72))
        climbs = ((low, 0.0), (high, DECK)) if up else ((low, DECK), (high, 0.0))
        out.append(Street(name, path, RAMP, 30, climbs=climbs, kind="motorway"))
    return tuple(out)


def _south_link() -> Path:
    """From the lower lobe's outer carriageway to that of the upper lobe."""
    start = _on_bend((-190, SOUTH + 190), 190 + HALF + 3.5, -40.0)
    leave = beside(start, 0.0, 130.0)
    x = EAST + HALF + 3.5
    return polyline(start[:2], (*leave[:2], 260), (235, -188, 250), (375, -112, 110), (x, -40, 90), (x, 75))


def _north_link() -> Path:
    """From the upper lobe's outer carriageway to lights on the western leg."""
    start = _on_bend((165, NORTH - 165), 165 + HALF + OUTER, 155.0)
    leave = beside(start, 0.0, 120.0)
    return polyline(start[:2], (*leave[:2], 230), (-170, 100, 190), (-290, 86, 200), (-385, 66, 62), (-385, LEG - 8))


def _on_bend(centre: tuple[float, float], radius: float, degrees: float) -> Pose:
    """The pose of counter-clockwise traffic on a bend."""
    angle = math.radians(degrees)
    return centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), angle + math.pi / 2


def _ramps() -> list[Node]:
    """Where loops and links leave and join. On each side of the crossing, one junction holds both carriageways with
    the loop that leaves one and the loop that joins the other."""
    far = HALF + OUTER + 12.0
    loops = (
        ("north", (0.0, LEG + far), "north to west", "west to south"),
        ("west", (-far, LEG), "west to south", "south to east"),
        ("south", (0.0, LEG - far), "south to east", "east to north"),
        ("east", (far, LEG), "east to north", "north to west"),
    )
    reach = HALF + OUTER + 0.5
    nodes = [
        Node(
            f"loops {side}",
            at,
            "yield",
            minor=(joining,),
            streets=("onward", "back", leaving, joining),
            reach=reach,
            radius=15,
            banned=((joining, "left"),),
        )
        for side, at, leaving, joining in loops
    ]
    for name, path, source, target in (
        ("south link", _south_link(), "onward", "back"),
        ("north link", _north_link(), "back", ""),
    ):
        first, last = path.pose(0.0)[:2], path.pose(path.length)[:2]
        nodes.append(Node(f"{source} to {name}", first, streets=(source, name), reach=6, radius=15))
        if target:
            nodes.append(Node(f"{name} to {target}", last, "yield", streets=(target, name), reach=6, radius=15))
    return nodes


def _nodes() -> tuple[Node, ...]:
    lit = [(200, 310), (255, 310), (200, 248), (312, 248), (60, 172), (130, 172), (255, 172), (312, 172), (352, 172)]
    lights = [Node(f"grid {x}, {y}", (x, y), "signal", crosswalks=True) for x, y in [*lit, (255, 120), (312, 120)]]
    lights.append(Node("western lights", (-385, LEG), "signal", streets=("onward", "back", "north link"), reach=13))
    stops = [
        Node(f"grid {x}, {y}", (x, y), "stop", minor=("long street", "inner street", "short street"))
        for x, y in ((255, 248), (200, 172))
    ]
    gates = [(HALF, 172), (EAST - HALF, 172), (EAST - HALF, 68), (200, NORTH - HALF)]
    slips = (
        Node("long street to slip", (104, 172), streets=("long street", "slip")),
        Node("slip to outer street", (60, 214), "yield", streets=("outer street", "slip")),
    )
    return (*_ramps(), *slips, *lights, *stops, *(Node(f"gate {x:.0f}, {y:.0f}", (x, y), "stop") for x, y in gates))
