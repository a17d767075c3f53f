"""T5: a grid of streets with two lanes each way inside a ring motorway of three, which rises over three of them
in the west."""

from __future__ import annotations

from me3bev_plugins.simulator.highway.towns.geometry import polyline
from me3bev_plugins.simulator.highway.towns.streets import Layout, Node, Section, Street

MOTORWAY = Section(3, 3, median=4.0, shoulder=1.5, sidewalk=0)
STREET = Section(2, 2, shoulder=0.5)
LANE = Section(1, 1, shoulder=0.5)
COLUMNS = (-189.0, -124.0, -48.0)
ROWS = (-89.0, 0.0, 91.0)
TOP, BOTTOM = 142.0, -149.0
RING = 198.0
BRIDGE = 10.0


def layout() -> Layout:
    """The town's streets and nodes."""
    return Layout("T5", "multi-lane grid inside a ring motorway", _streets(), _nodes())


def _streets() -> tuple[Street, ...]:
    ring = polyline((-238, -RING, 102), (201, -RING, 102), (201, RING, 102), (-238, RING, 102), closed=True)
    rise = (((-25, -RING), 0.0), ((-150, -RING), BRIDGE), ((-150, RING), BRIDGE), ((-25, RING), 0.0))
    west, _, east = COLUMNS
    return (
        Street("ring", ring, MOTORWAY, 90, climbs=rise, kind="motorway"),
        Street(
            "belt",
            polyline((-270, ROWS[0], 32), (103, ROWS[0], 42), (103, ROWS[2], 42), (-270, ROWS[2], 38), closed=True),
            STREET,
            50,
        ),
        Street(
            "block",
            polyline((west, BOTTOM, 27), (east, BOTTOM, 27), (east, TOP, 45), (west, TOP, 28), closed=True),
            STREET,
            50,
        ),
        Street("middle", polyline((COLUMNS[1], BOTTOM), (COLUMNS[1], TOP)), STREET, 40),
        Street("axis", polyline((-270, ROWS[1]), (103, ROWS[1])), STREET, 50),
        Street("main", polyline((29, -RING), (33, RING)), STREET, 60),
        Street("spur", polyline((103, ROWS[1]), (153, ROWS[1])), LANE, 40),
        Street(
            "east loop",
            polyline((29.5, -143), (95, -147, 90), (153, -112, 38), (153, 120, 42), (90, 150, 90), (32, 148)),
            LANE,
            40,
        ),
    )


def _nodes() -> tuple[Node, ...]:
    crossings = [(x, y) for x in (*COLUMNS, 31.0) for y in ROWS] + [(103.0, ROWS[1])]
    names = [("belt", "axis", "belt")[i % 3] for i in range(12)] + ["belt"]
    others = ["block"] * 3 + ["middle"] * 3 + ["block"] * 3 + ["main"] * 3 + ["axis"]
    lights = tuple(
        Node(f"{name} and {other} {i}", point, "signal", (name, other), crosswalks=True)
        for i, (point, name, other) in enumerate(zip(crossings, names, others, strict=True), 1)
    )
    ring = tuple(
        Node(f"ring and main {y:.0f}", (31, y), "signal", ("ring", "main"), crosswalks=False) for y in (-RING, RING)
    )
    signs = (
        Node("belt and axis", (-270, ROWS[1]), "stop"),
        Node("block and middle, south", (COLUMNS[1], BOTTOM), "stop"),
        Node("block and middle, north", (COLUMNS[1], TOP), "stop"),
        Node("main and east loop, south", (29.5, -143), "yield", ("main", "east loop")),
        Node("main and east loop, north", (32.5, 148), "yield", ("main", "east loop")),
        Node("spur and east loop", (153, ROWS[1]), "stop"),
    )
    return (*lights, *ring, *signs)
