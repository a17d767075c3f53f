"""Rush hour, measured: `python -m me3bev_plugins.simulator.highway.traffic_stress --minutes 10`.

Runs the traffic of towns for minutes on end, without an ego, and prints a row per town: what overlapped, who was hit,
who stood for how long, how fast the traffic was, and what it was made of.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.pedestrian_kernel import CROSS as CROSSING
from me3bev_plugins.simulator.highway.scene import Ego, Kind
from me3bev_plugins.simulator.highway.town import Floats, Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_conflicts import boxes_touch
from me3bev_plugins.simulator.highway.traffic_state import Fleet
from me3bev_plugins.simulator.highway.traffic_tables import Roads

NOBODY = Ego(1e5, 1e5, 0.0, 0.0, 0.0)
"""An ego that is nowhere near."""
LEVEL = 2.5
"""Difference of height beyond which nothing meets, metres."""
STANDING = 0.2
"""Slower than this is standing, m/s."""


class Stress(NamedTuple):
    """What minutes of traffic came to."""

    vehicles: int
    pedestrians: int
    overlaps: int
    """Pairs of vehicles that overlapped at some time."""
    hit: int
    """Pairs of a vehicle and a pedestrian that did."""
    longest_stand: float
    """The longest time that a vehicle stood anywhere but in a queue at a light, seconds."""
    longest_queue: float
    """The longest time that a vehicle stood in a queue at a light, seconds."""
    speed: float
    """Mean of the vehicles, m/s."""
    crossings: int
    """Roads crossed by pedestrians at crosswalks and corners."""
    elsewhere: int
    """Roads crossed by pedestrians anywhere else."""
    kinds: dict[str, int]
    """Vehicles by kind."""


@njit(cache=True)
def _overlapping(pose: Floats, length: Floats, width: Floats, vehicles: int, pairs: NDArray[np.bool_]) -> None:
    """Mark pairs (vehicle, actor) whose boxes overlap in `pairs` (N, A)."""
    for i in range(vehicles):
        for j in range(i + 1, pose.shape[1]):
            dx, dy = pose[0, j] - pose[0, i], pose[1, j] - pose[1, i]
            reach = 0.5 * (length[i] + width[i] + length[j] + width[j])
            if dx * dx + dy * dy > reach * reach or abs(pose[2, j] - pose[2, i]) > LEVEL:
                continue
            ca, sa, cb, sb = np.cos(pose[3, i]), np.sin(pose[3, i]), np.cos(pose[3, j]), np.sin(pose[3, j])
            if boxes_touch(dx, dy, ca, sa, cb, sb, 0.5 * length[i], 0.5 * width[i], 0.5 * length[j], 0.5 * width[j]):
                pairs[i, j] = True


@njit(cache=True)
def _in_light_queue(roads: Roads, fleet: Fleet, queued: NDArray[np.bool_]) -> None:
    """Whether the first gate ahead of each vehicle is behind a light, into `queued` (N,)."""
    for i in range(len(queued)):
        queued[i] = False
        if roads.lanes[fleet.path[i, 0]].gate:
            continue
        for k in range(1, fleet.cars[i].count):
            if roads.lanes[fleet.path[i, k]].gate:
                queued[i] = roads.lanes[fleet.path[i, k - 1]].signal >= 0
                break


def stress(
    town: Town,
    seconds: float,
    seed: int = 0,
    vehicles: int = 100,
    pedestrians: int = 100,
) -> Stress:
    """Let the traffic of a town run and watch it every step."""
    traffic = Traffic(town)
    path = EgoPath(np.zeros(1, np.int32), 0, 1.0, 0.0)
    traffic.reset(np.random.default_rng(seed), vehicles, pedestrians, NOBODY, path)
    actors, people = traffic.actors, traffic._people
    count = int((actors.kind != Kind.PEDESTRIAN).sum())
    pairs, queued = np.zeros((count, len(actors)), np.bool_), np.zeros(count, np.bool_)
    still, longest = np.zeros(count), np.zeros(2)
    speed = 0.0
    crossings = traffic._tables.walks.crossings
    proper = crossings["marked"] | crossings["corner"]
    crossed = np.zeros(2, np.int64)
    walking = people["mode"] == CROSSING
    steps = round(seconds * 10)
    for _ in range(steps):
        traffic.step(0.1, NOBODY, path)
        _overlapping(traffic._pose, actors.length, actors.width, count, pairs)
        _in_light_queue(traffic._tables.roads, traffic._fleet, queued)
        still = np.where(actors.speed[:count] < STANDING, still + 0.1, 0.0)
        for n, group in enumerate((still[~queued], still[queued])):
            longest[n] = max(longest[n], group.max(initial=0.0))
        speed += float(actors.speed[:count].mean()) / steps if count else 0.0
        begun = (people["mode"] == CROSSING) & ~walking
        walking = people["mode"] == CROSSING
        crossed += np.bincount(proper[people["crossing"][begun]], minlength=2)
    kinds = {Kind(k).name.lower(): int((actors.kind == k).sum()) for k in Kind if k != Kind.PEDESTRIAN}
    return Stress(
        vehicles=count,
        pedestrians=len(people),
        overlaps=int(pairs[:, :count].sum()),
        hit=int(pairs[:, count:].sum()),
        longest_stand=float(longest[0]),
        longest_queue=float(longest[1]),
        speed=speed,
        crossings=int(crossed[1]),
        elsewhere=int(crossed[0]),
        kinds=kinds,
    )


def _row(name: str, seed: int, s: Stress) -> str:
    kinds = " ".join(f"{kind} {number}" for kind, number in s.kinds.items())
    return (
        f"{name:8} {seed:4} {s.overlaps:8} {s.hit:4} {s.longest_stand:7.1f} {s.longest_queue:7.1f} {s.speed:6.2f} "
        f"{s.crossings:6} {s.elsewhere:6}  {s.pedestrians} on foot, {kinds}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row per town and seed; 1 if anything overlapped, was hit or stood for over 90 s off a light's queue."""
    parser = argparse.ArgumentParser(prog="traffic_stress", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--maps", nargs="+", default=list(MAPS), help="built-in names or OpenDRIVE files")
    parser.add_argument("--seeds", type=int, default=1, help="how many")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--vehicles", type=int, default=100)
    parser.add_argument("--pedestrians", type=int, default=100)
    options = parser.parse_args(arguments)
    print("map      seed overlaps  hit stand s queue s    m/s  marked elsewhere")
    failed = False
    for name in options.maps:
        town = load_town(name) if name in MAPS else read_town(Path(name), Path(name).stem)
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            s = stress(town, 60 * options.minutes, seed, options.vehicles, options.pedestrians)
            print(_row(town.name, seed, s), flush=True)
            failed |= bool(s.overlaps or s.hit or s.longest_stand > 90.0)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
