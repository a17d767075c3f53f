"""What went wrong in episodes, when, and which of it is shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.evaluation.episode import Episode

KINDS = {
    "vehicle": "Collision with a vehicle",
    "pedestrian": "Collision with a pedestrian",
    "static": "Collision with something that never moves",
    "red_light": "Ran a red light",
    "stop_sign": "Ran a stop sign",
    "off_road": "Left the road",
    "lane_departure": "Left its lane",
    "timeout": "Time was up before the end of the route",
    "stopped": "Ended by the simulator",
}
"""Every kind of failure, for people, the worst first."""


@dataclass(frozen=True, eq=False)
class Failure:
    """One event of one episode."""

    kind: str
    episode: Episode
    step: int
    """Index of the step in which it happened."""
    at_fault: bool = False
    """Of a collision: whether the ego's front ran into the other."""


def failures(episode: Episode) -> list[Failure]:
    """Each kind of failure of an episode where it first happened."""
    found = []
    for kind in ("vehicle", "pedestrian", "static"):
        found += _first(episode, kind, episode["collision"] == kind)
    for kind in ("red_light", "stop_sign", "off_road"):
        found += _first(episode, kind, episode[kind])
    found += _first(episode, "lane_departure", episode["lane_departure"] & ~episode["off_road"])
    if episode.ended in ("timeout", "stopped"):
        found.append(Failure(episode.ended, episode, len(episode) - 1))
    return found


def _first(episode: Episode, kind: str, where: NDArray[np.bool_]) -> list[Failure]:
    if not where.any():
        return []
    step = int(np.argmax(where))
    return [Failure(kind, episode, step, bool(episode["collision"][step]) and bool(episode["at_fault"][step]))]


def counted(episodes: Sequence[Episode]) -> dict[str, Counter[str]]:
    """Kind -> driver -> in how many of its episodes it happened."""
    found: dict[str, Counter[str]] = {kind: Counter() for kind in KINDS}
    for episode in episodes:
        for failure in failures(episode):
            found[failure.kind][episode.driver] += 1
    return found


def chosen(episodes: Sequence[Episode], each: int) -> list[Failure]:
    """Some failures of each kind: as many drivers and maps as can be, the ego's own doing first.

    The same episodes always give the same choice.
    """
    by_kind: dict[str, list[Failure]] = {kind: [] for kind in KINDS}
    for episode in episodes:
        for failure in failures(episode):
            by_kind[failure.kind].append(failure)
    return [failure for found in by_kind.values() for failure in _spread(found)[:each]]


def _spread(found: Sequence[Failure]) -> list[Failure]:
    """In an order in which each driver, and each map of it, has its turn."""
    drivers: dict[str, dict[str, list[Failure]]] = {}
    for failure in sorted(found, key=lambda f: (not f.at_fault, f.episode.index)):
        place = f"{failure.episode.map} {failure.episode.density}"
        drivers.setdefault(failure.episode.driver, {}).setdefault(place, []).append(failure)
    return _turns([_turns(list(places.values())) for places in drivers.values()])


def _turns(lines: Sequence[Sequence[Failure]]) -> list[Failure]:
    """The first of each line, the second of each, and so on."""
    longest = max(map(len, lines), default=0)
    return [line[place] for place in range(longest) for line in lines if place < len(line)]


def about(failure: Failure) -> Mapping[str, object]:
    """A failure as plain values."""
    episode = failure.episode
    return {
        "kind": failure.kind,
        "method": episode.driver,
        "map": episode.map,
        "density": episode.density,
        "weather": episode.weather,
        "episode": episode.index,
        "seed": episode.seed,
        "step": failure.step + 1,
        "seconds": float(episode["time"][failure.step]),
        "at_fault": failure.at_fault,
    }
