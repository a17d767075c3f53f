"""`Traffic`: the living part of a town. Vehicles, pedestrians and lights, advanced in arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.pedestrians import Looks, draw_people
from me3bev_plugins.simulator.highway.scene import Actors, Ego, Kind
from me3bev_plugins.simulator.highway.signals import draw_plan
from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.traffic_kernel import advise_ego, decide, look_around, publish, step_traffic
from me3bev_plugins.simulator.highway.traffic_records import LARGE, PATH, SMALL
from me3bev_plugins.simulator.highway.traffic_spawn import draw_models, put_vehicles, size_bit, stretches
from me3bev_plugins.simulator.highway.traffic_state import extend, new_board, new_fleet, set_out
from me3bev_plugins.simulator.highway.traffic_tables import tables

HEAVY = 0.88
"""How much more slowly trucks are driven."""
STRONGEST = 3.5
"""The most that the ego can be told to speed up, m/s^2."""


class Traffic:
    """All that moves in a town besides the ego.

    Vehicles drive by highway-env's IDM to destinations, one after another, change lanes by its MOBIL to get there and
    to pass slower ones, obey limits, lights and signs, and take turns at junctions. The ego is one more vehicle to
    them: it is given room wherever its box is, and its right of way.
    Everything is drawn from the generator given to `reset`: the same one makes the same episode, byte by byte.
    """

    actors: Actors
    lights: np.ndarray
    """(S,) `Light` of each of the town's signals."""

    def __init__(self, town: Town) -> None:
        self.town = town
        self._tables = tables(town)

    def reset(self, rng: np.random.Generator, vehicles: int, pedestrians: int, ego: Ego, path: EgoPath) -> None:
        """Begin an episode.

        Args:
            rng: source of everything random in it.
            vehicles, pedestrians: how many; as many as find room.
            ego: where the ego starts; the road 12 m before it and 25 m behind it stays free.
            path: its route.
        """
        roads = self._tables.roads
        self._plan = draw_plan(self.town, rng)
        self._time = 0.0
        admitted = int(np.bitwise_or.reduce(roads.lanes["admits"]))
        models = draw_models(rng, vehicles, admitted)
        index, lane, s, speed = put_vehicles(rng, roads, models, stretches(self.town, roads, ego, path))
        seeds = rng.integers(0, 2**63, vehicles + 1, dtype=np.uint64)
        eager = rng.uniform(0.85, 1.0, vehicles) * np.where(models.kind == Kind.TRUCK, HEAVY, 1.0)
        count = len(index)
        self._fleet = new_fleet(count)
        cars = self._fleet.cars[:count]
        for name in ("length", "width", "height", "kind"):
            cars[name] = getattr(models, name)[index]
        cars["s"], cars["speed"], cars["rng"], cars["eager"] = s, speed, seeds[index], eager[index]
        cars["size"] = cars["length"] > 2 * LARGE
        cars["admits"] = [size_bit(float(length)) for length in cars["length"]]
        cars["gate"] = cars["halted"] = cars["leaving"] = -1
        cars["timer"] = rng.uniform(0.0, float(roads.mobil[3]), vehicles)[index]
        cars["count"] = 1
        self._fleet.path[:count, 0] = lane
        walks = self._tables.walks
        self._people, looks = draw_people(rng, walks, pedestrians)
        self._board = new_board(len(roads.lanes), count, len(self.town.signals), len(roads.links), len(walks.crossings))
        self.lights = self._board.lights
        set_out(roads, self._board.queues, self._fleet)
        self._enter_ego(ego, seeds[-1])
        self._make_actors(models.colour[index], looks)
        self._locate_ego(ego, path)
        look_around(roads, self._tables.grid, self._plan, self._fleet, self._board, self._time)
        decide(roads, self._fleet, self._board, self._time, 0.0)
        publish(self._fleet, self._people, self._pose, self.actors.braking)

    def step(self, dt: float, ego: Ego, path: EgoPath) -> None:
        """Advance by `dt` seconds. The ego has moved already: `ego` and `path` say where it is now."""
        self._locate_ego(ego, path)
        self._time += dt
        t = self._tables
        step_traffic(
            t.roads, t.grid, t.walks, self._plan, self._fleet, self._people, self._board,
            self._pose, self.actors.braking, self._time, dt,
        )  # fmt: skip

    def advise(self, ego: Ego, path: EgoPath) -> float:
        """The acceleration that a careful, law-abiding driver would choose for the ego now, m/s^2 in [-8, 3.5].

        It changes nothing: an episode is the same whether or not anybody asks.
        """
        self._locate_ego(ego, path)
        t = self._tables
        return float(min(advise_ego(t.roads, t.grid, self._fleet, self._board), STRONGEST))

    def _enter_ego(self, ego: Ego, seed: np.uint64) -> None:
        car = self._fleet.cars[-1]
        car["length"], car["width"], car["height"], car["kind"] = ego.length, ego.width, ego.height, Kind.CAR
        car["rng"], car["eager"], car["admits"], car["size"] = seed, 1.0, SMALL, int(ego.length > 2 * LARGE)
        car["gate"] = car["halted"] = car["leaving"] = car["goal"] = -1
        self._ego_way: tuple[int, ...] = ()

    def _locate_ego(self, ego: Ego, path: EgoPath) -> None:
        """Copy the ego's pose and way into its record. Grants shrink as it passes lanes."""
        car, way, trail = self._fleet.cars[-1], self._fleet.path[-1], self._fleet.trail[-1]
        car["x"], car["y"], car["z"], car["heading"], car["speed"] = ego.x, ego.y, ego.z, ego.heading, ego.speed
        car["s"], car["offset"] = path.s, path.lateral
        ahead = tuple(int(lane) for lane in path.lanes[path.index : path.index + PATH])
        if ahead == self._ego_way:
            return
        old, self._ego_way = self._ego_way, ahead
        passed = old.index(ahead[0]) if ahead[0] in old else len(old)
        car["clear"] = max(0, int(car["clear"]) - passed)
        behind = path.lanes[max(0, path.index - len(trail)) : path.index][::-1]
        trail[:] = -1
        trail[: len(behind)] = behind
        way[: len(ahead)] = ahead
        car["count"] = len(ahead)
        rng = car["rng"]
        extend(self._tables.roads, self._board.queues, car, way)  # Drivers look beyond the end of the route.
        car["rng"] = rng

    def _make_actors(self, colour: NDArray[np.uint8], looks: Looks) -> None:
        cars = self._fleet.cars[:-1]
        count, people = len(cars), len(self._people)
        self._pose = np.zeros((5, count + people))
        self.actors = Actors(
            *self._pose,
            length=np.concatenate([cars["length"], looks.length]),
            width=np.concatenate([cars["width"], looks.width]),
            height=np.concatenate([cars["height"], looks.height]),
            kind=np.concatenate([cars["kind"], np.full(people, Kind.PEDESTRIAN)]).astype(np.int32),
            colour=np.concatenate([colour, looks.colour]).astype(np.uint8),
            braking=np.zeros(count + people, np.bool_),
        )
