"""The facts of a town beside those of the one it is a twin of."""

from __future__ import annotations

from collections.abc import Iterator

from me3bev_cli.api import FactRow
from me3bev_plugins.simulator.highway.towns.facts import Facts
from me3bev_plugins.simulator.highway.towns.reference import REFERENCES, Reference

SIZE = 0.15
"""Allowed share of difference in lane kilometres and lights."""
COUNT = (1.0, 0.15)
"""Allowed difference in junctions of a kind: so many, or this share."""
POINTS = 0.12
"""Allowed difference in shares of lanes and limits."""
STRAIGHT = 0.10
WIDTH = 0.1
"""Metres."""
RADIUS = 0.30
BLOCK = 0.25

KINDS = {
    "3": "3-arm junctions",
    "4": "4-arm junctions",
    "5": "5-arm junctions",
    "merge": "merges",
    "roundabout": "roundabouts",
    "pass": "2-arm junctions",
}
FURNITURE = {"light": "traffic lights", "stop": "stop signs", "yield": "yield signs", "crosswalk": "crosswalks"}


def compare(name: str, facts: Facts) -> tuple[FactRow, ...]:
    """Every fact of a town as a row, with its reference where the town has one.

    Args:
        name: of the town; only the built-in ones have references.
        facts: as measured.
    """
    reference = REFERENCES.get(name)
    return (
        *_sizes(facts, reference),
        *_junctions(facts, reference),
        *_shares(facts, reference),
        *_shapes(facts, reference),
        *_untested(facts, reference),
    )


def _near(key: str, value: float, unit: str, wanted: float | None, share: float) -> FactRow:
    """A row that may differ by a share of its reference."""
    if wanted is None:
        return FactRow(key, value, unit)
    within = abs(value - wanted) <= share * wanted + 1e-9
    return FactRow(key, value, unit, wanted, f"{share:.0%}".replace("%", " %"), within)


def _sizes(facts: Facts, reference: Reference | None) -> Iterator[FactRow]:
    yield _near("lanes", facts.lane_km, "km", reference and reference.lane_km, SIZE)
    yield _near(
        "junctions with lights", float(facts.signalised), "", float(reference.signalised) if reference else None, SIZE
    )


def _junctions(facts: Facts, reference: Reference | None) -> Iterator[FactRow]:
    least, share = COUNT
    for kind, key in KINDS.items():
        value = float(facts.intersections[kind])
        if reference is None:
            yield FactRow(key, value, "")
        else:
            wanted = float(reference.intersections[kind])
            within = abs(value - wanted) <= max(least, share * wanted)
            yield FactRow(key, value, "", wanted, f"{least:.0f} or {100 * share:.0f} %", within)


def _shares(facts: Facts, reference: Reference | None) -> Iterator[FactRow]:
    tables = (
        ("lanes per direction: {}", facts.lanes_per_direction, reference and reference.lanes_per_direction),
        ("limit of {} km/h", facts.posted_kmh, reference and reference.posted_kmh),
    )
    for key, measured, wanted in tables:
        for number in sorted({*measured, *(wanted or {})}):
            share = measured.get(number, 0.0)
            yield _points(key.format(number), share, None if wanted is None else wanted.get(number, 0.0), POINTS)


def _points(key: str, share: float, wanted: float | None, most: float) -> FactRow:
    """A share in per cent that may differ by so many points."""
    if wanted is None:
        return FactRow(key, 100 * share, "%")
    return FactRow(key, 100 * share, "%", 100 * wanted, f"{100 * most:.0f} points", abs(share - wanted) <= most + 1e-9)


def _shapes(facts: Facts, reference: Reference | None) -> Iterator[FactRow]:
    width = facts.width[1]
    if reference is None:
        yield FactRow("median lane width", width, "m")
    else:
        within = abs(width - reference.width) <= WIDTH + 1e-9
        yield FactRow("median lane width", width, "m", reference.width, f"{WIDTH} m", within)
    yield _points("straight lanes", facts.straight, reference and reference.straight, STRAIGHT)
    yield _near("median bend radius", facts.bend_radius, "m", reference and reference.bend_radius, RADIUS)
    yield _near("median block", facts.block[1], "m", reference and reference.block, BLOCK)


def _untested(facts: Facts, reference: Reference | None) -> Iterator[FactRow]:
    """What is told beside its reference without a bound."""
    box, z = (reference.box, reference.z) if reference else ((None, None), (None, None))
    yield FactRow("extent, west to east", facts.box[0], "m", box[0])
    yield FactRow("extent, south to north", facts.box[1], "m", box[1])
    yield FactRow("lowest lane", facts.z[0], "m", z[0])
    yield FactRow("highest lane", facts.z[1], "m", z[1])
    yield FactRow("crossings on two levels", float(facts.levels), "", float(reference.levels) if reference else None)
    for kind, key in FURNITURE.items():
        wanted = reference.furniture[kind] if reference else None
        yield FactRow(key, float(facts.furniture[kind]), "", None if wanted is None else float(wanted))
