"""highway-env's view of a town: its lanes, its road network, and the road whose step moves everything."""

from __future__ import annotations

from collections import defaultdict
from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from me3bev_plugins.simulator.highway.ego import EgoVehicle
from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.lane_grid import LaneGrid, Place
from me3bev_plugins.simulator.highway.routes import RouteTracker
from me3bev_plugins.simulator.highway.scene import Ego
from me3bev_plugins.simulator.highway.stock import AbstractLane, LaneIndex, LineType, Road, RoadNetwork
from me3bev_plugins.simulator.highway.town import Floats, Lane, Marking, Town

_LINES: dict[Marking, int] = {
    "none": LineType.NONE,
    "solid": LineType.CONTINUOUS_LINE,
    "broken": LineType.STRIPED,
    "yellow_solid": LineType.CONTINUOUS_LINE,
    "yellow_broken": LineType.STRIPED,
}


class TownLane(AbstractLane):
    """A town's lane with highway-env's interface. Lateral offsets are positive to the left, metres."""

    def __init__(self, lane: Lane) -> None:
        self.lane = lane
        self.width = lane.width
        self.length = lane.length
        self.speed_limit = lane.limit
        self.line_types = [_LINES[lane.left_marking], _LINES[lane.right_marking]]
        self.forbidden = False
        self.priority = 0

    def _segment(self, longitudinal: float) -> tuple[int, Floats]:
        """Index of the segment at an arc length and its unit direction; the first and last go on for ever."""
        i = int(np.clip(np.searchsorted(self.lane.s, longitudinal, side="right") - 1, 0, len(self.lane.s) - 2))
        step = self.lane.points[i + 1, :2] - self.lane.points[i, :2]
        return i, step / np.hypot(*step)

    def position(self, longitudinal: float, lateral: float) -> Floats:
        """World position (2,) of lane coordinates, metres."""
        i, direction = self._segment(longitudinal)
        left = np.array([-direction[1], direction[0]])
        point: Floats = self.lane.points[i, :2] + (longitudinal - self.lane.s[i]) * direction + lateral * left
        return point

    def local_coordinates(self, position: Any) -> tuple[float, float]:
        """(arc length, lateral) of the nearest point of the centre line; straight on beyond either end."""
        points, s = self.lane.points[:, :2], self.lane.s
        steps, sizes = np.diff(points, axis=0), np.diff(s)
        from_start = np.asarray(position, np.float64)[:2] - points[:-1]
        along = np.einsum("ij,ij->i", from_start, steps) / sizes
        low, high = np.zeros(len(sizes)), sizes.copy()
        low[0], high[-1] = -np.inf, np.inf
        along = np.clip(along, low, high)
        error = from_start - steps * (along / sizes)[:, None]
        i = int(np.argmin(np.einsum("ij,ij->i", error, error)))
        side = steps[i, 0] * error[i, 1] - steps[i, 1] * error[i, 0]
        return float(s[i] + along[i]), float(np.copysign(np.hypot(*error[i]), side))

    def heading_at(self, longitudinal: float) -> float:
        """Direction of travel, radians."""
        return float(np.interp(longitudinal, self.lane.s, self.lane.heading))

    def width_at(self, longitudinal: float) -> float:
        """Metres; the same all along."""
        return self.width

    @classmethod
    def from_config(cls, config: dict[str, Any]) -> TownLane:
        """The lane of `to_config`."""
        points = np.array(config["points"], np.float64)
        return cls(Lane(id=config["id"], points=points, width=config["width"], limit=config["limit"]))

    def to_config(self) -> dict[str, Any]:
        """The geometry as plain values."""
        lane = self.lane
        return {"id": lane.id, "points": lane.points.tolist(), "width": lane.width, "limit": lane.limit}


class TownNetwork(RoadNetwork):
    """A road network that also knows the town's lane ids and finds the nearest lane without reading them all."""

    def __init__(self, town: Town) -> None:
        super().__init__()
        self.town = town
        self.grid = LaneGrid(town)
        self.index_of: list[LaneIndex] = [("", "", 0)] * len(town.lanes)

    def locate(self, x: float, y: float, z: float, heading: float) -> Place:
        """The lanes around a point; see `LaneGrid.locate`."""
        return self.grid.locate(x, y, z, heading)

    def get_closest_lane_index(self, position: Any, heading: float | None = None) -> LaneIndex:
        """Index of the lane that fits a position and a heading best, on any level."""
        return self.index_of[self.grid.nearest(float(position[0]), float(position[1]), heading)]


def _nodes(town: Town) -> tuple[list[int], list[int]]:
    """For each lane the node at which it begins and the one at which it ends.

    Joined ends share a node, and so do those of neighbours: lanes side by side are one road of the network.
    """
    count = len(town.lanes)
    parent = list(range(2 * count))

    def find(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for lane in town.lanes:
        for follower in lane.successors:
            parent[find(count + lane.id)] = find(follower)
        for side in (lane.left, lane.right):
            if side is not None:
                parent[find(lane.id)] = find(side)
                parent[find(count + lane.id)] = find(count + side)
    return [find(i) for i in range(count)], [find(count + i) for i in range(count)]


@lru_cache(maxsize=16)
def road_network(town: Town) -> TownNetwork:
    """The town as highway-env's road network: an edge per lane, lanes side by side ordered from the left."""
    network = TownNetwork(town)
    starts, ends = _nodes(town)
    roads: dict[tuple[int, int], list[Lane]] = defaultdict(list)
    for lane in town.lanes:
        roads[starts[lane.id], ends[lane.id]].append(lane)

    def from_left(lane: Lane) -> int:
        steps, seen = 0, {lane.id}
        while lane.left is not None and lane.left not in seen:
            lane, steps = town.lanes[lane.left], steps + 1
            seen.add(lane.id)
        return steps

    for (start, end), lanes in roads.items():
        for position, lane in enumerate(sorted(lanes, key=lambda lane: (from_left(lane), lane.id))):
            network.add_lane(str(start), str(end), TownLane(lane))
            network.index_of[lane.id] = (str(start), str(end), position)
    return network


class Movement(Protocol):
    """What moves besides the ego."""

    def step(self, dt: float, ego: Ego, path: EgoPath) -> None:
        """Advance by `dt` seconds; the ego has already moved."""
        ...


class TownRoad(Road):  # type: ignore[misc]  # highway-env has no types
    """A road whose step moves the ego by its kinematics, then the traffic, all at once, in arrays."""

    def __init__(self, network: TownNetwork, np_random: np.random.Generator) -> None:
        super().__init__(network=network, np_random=np_random)
        self.ego: EgoVehicle | None = None
        self.tracker: RouteTracker | None = None
        self.traffic: Movement | None = None

    def populate(self, ego: EgoVehicle, tracker: RouteTracker, traffic: Movement) -> None:
        """Put the ego, the route it is to follow and the traffic on the road."""
        self.ego, self.tracker, self.traffic = ego, tracker, traffic
        self.vehicles = [ego]

    def step(self, dt: float) -> None:
        """Advance by `dt` seconds. Collisions are judged by the environment, not pair by pair here."""
        if self.ego is None or self.tracker is None or self.traffic is None:
            raise RuntimeError("step() before populate()")
        self.ego.step(dt)
        pose = self.ego.pose
        self.tracker.update(pose.x, pose.y)
        self.traffic.step(dt, pose, self.tracker.path)
