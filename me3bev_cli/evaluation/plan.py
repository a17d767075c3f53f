"""Which episodes are to be driven, and in which pieces."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import NamedTuple

from me3bev_cli.evaluation.crew import ROWS
from me3bev_cli.evaluation.player import Job

LARGEST = 8 * ROWS
"""Episodes of a job at most: the longer it is, the less a row waits for the others at its end."""
PER_WORKER = 4
"""Jobs that each worker should have at least, so that all of them finish at about the same time."""


class Visit(NamedTuple):
    """One episode of one method."""

    method: int
    map: str
    density: str
    number: int
    """Index of the episode."""


def visits(methods: int, maps: Sequence[str], densities: Sequence[str], episodes: int) -> list[Visit]:
    """Every episode of an evaluation, method by method and cell by cell."""
    return [
        Visit(method, map, density, number)
        for method in range(methods)
        for density in densities
        for map in maps
        for number in range(episodes)
    ]


def jobs_for(wanted: Sequence[Visit], done: Container[Visit], workers: int) -> list[Job]:
    """The episodes that are not done yet as jobs, none of them over two cells.

    How they are cut changes no figure: an episode has the same numbers in any company.
    """
    missing: dict[tuple[int, str, str], list[int]] = {}
    for visit in wanted:
        if visit not in done:
            missing.setdefault(visit[:3], []).append(visit.number)
    count = sum(map(len, missing.values()))
    each = -(-count // (PER_WORKER * max(1, workers)))
    size = min(LARGEST, max(ROWS, -(-each // ROWS) * ROWS))
    return [
        Job(*cell, tuple(indices[first : first + size]))
        for cell, indices in missing.items()
        for first in range(0, len(indices), size)
    ]


def look_into(visit: Visit) -> Job:
    """A job that drives no episode but takes a picture of one."""
    return Job(visit.method, visit.map, visit.density, (), snapshot=visit.number)
