"""The whole: a crowded town in which nothing overlaps, nothing stands still for ever and every run is the same."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import box, ego_box, ego_on, overlap

from me3bev_plugins.simulator.highway.scene import Kind
from me3bev_plugins.simulator.highway.town import Lane, Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_spawn import CLEAR_AHEAD, CLEAR_BEHIND

TOWN = build_tiny_town()


def begin(seed: int, vehicles: int, pedestrians: int, lane: int = 8, s: float = 20.0) -> tuple[Traffic, tuple]:
    ego = ego_on(TOWN, [lane, TOWN.lanes[lane].successors[0]], s)
    traffic = Traffic(TOWN)
    traffic.reset(np.random.default_rng(seed), vehicles, pedestrians, *ego)
    return traffic, ego


def near(traffic: Traffic, reach: float = 8.0) -> list[tuple[int, int]]:
    a = traffic.actors
    vehicles = np.flatnonzero(a.kind != Kind.PEDESTRIAN)
    return [(i, j) for i, j in combinations(vehicles, 2) if np.hypot(a.x[i] - a.x[j], a.y[i] - a.y[j]) < reach]


def test_nothing_overlaps_and_everything_moves_over_a_minute() -> None:
    traffic, (ego, path) = begin(4, 16, 40)
    ego.x, ego.y = 1e4, 1e4  # The lane is free for the others.
    moved = np.zeros(len(traffic.actors))
    for _ in range(600):
        traffic.step(0.1, ego, path)
        moved += traffic.actors.speed * 0.1
        for i, j in near(traffic):
            assert not overlap(box(traffic.actors, i), box(traffic.actors, j))
        people = np.flatnonzero(traffic.actors.kind == Kind.PEDESTRIAN)
        for i in range(16):
            away = np.hypot(
                traffic.actors.x[people] - traffic.actors.x[i], traffic.actors.y[people] - traffic.actors.y[i]
            )
            for j in people[away < 6.0]:
                assert not overlap(box(traffic.actors, i), box(traffic.actors, int(j)))
    assert moved[:16].min() > 60.0
    assert moved[:16].mean() > 200.0


def test_the_same_generator_gives_the_same_bytes() -> None:
    def play(seed: int, before: int | None = None) -> bytes:
        traffic, (ego, path) = begin(seed if before is None else before, 14, 20)
        if before is not None:  # An episode before must leave no trace.
            for _ in range(50):
                traffic.step(0.1, ego, path)
            traffic.reset(np.random.default_rng(seed), 14, 20, ego, path)
        states = []
        for _ in range(200):
            traffic.step(0.1, ego, path)
            states += [traffic._pose.tobytes(), traffic.lights.tobytes(), traffic.actors.braking.tobytes()]
        return b"".join(states)

    assert play(1) == play(1) == play(1, before=2)
    assert play(1) != play(2)


@pytest.mark.parametrize("seed", range(5))
def test_spawning_leaves_gaps_and_the_ego_its_room(seed: int) -> None:
    traffic, (ego, path) = begin(seed, 25, 0, lane=0, s=60.0)
    a, cars = traffic.actors, traffic._fleet.cars[:-1]
    lanes = traffic._fleet.path[:-1, 0]
    assert len(a) == 25
    assert all(TOWN.lanes[lane].junction is None for lane in lanes)
    for i, j in combinations(range(25), 2):
        assert not overlap(box(a, i), box(a, j))
        if lanes[i] == lanes[j]:
            assert abs(cars["s"][i] - cars["s"][j]) - (a.length[i] + a.length[j]) / 2 >= 8.0 - 1e-9
    for i in np.flatnonzero(lanes == 0):
        ahead = cars["s"][i] - path.s
        gap = abs(ahead) - (a.length[i] + ego.length) / 2
        assert gap >= (CLEAR_AHEAD if ahead > 0 else CLEAR_BEHIND) - 1e-9
    assert not any(overlap(box(a, i), ego_box(ego)) for i in range(25))


def test_as_many_as_fit_and_not_more() -> None:
    traffic, _ = begin(0, 500, 10)
    vehicles = int((traffic.actors.kind != Kind.PEDESTRIAN).sum())
    assert 40 < vehicles < 130
    assert (traffic.actors.kind[:vehicles] != Kind.PEDESTRIAN).all()


def test_kinds_and_sizes_are_mixed() -> None:
    traffic, _ = begin(0, 60, 5)
    a = traffic.actors
    cars = a.kind == Kind.CAR
    assert {int(k) for k in a.kind} == {int(k) for k in Kind}
    assert ((a.length[cars] >= 4.2) & (a.length[cars] <= 5.0)).all()
    assert a.length.max() <= 12.0
    assert len({tuple(c) for c in a.colour[cars].tolist()}) > 4
    for array in (a.x, a.y, a.z, a.heading, a.speed, a.length, a.width, a.height):
        assert array.shape == (len(a),)
        assert array.dtype == np.float64
        assert array.flags.c_contiguous
    assert (a.kind.dtype, a.colour.dtype, a.braking.dtype) == (np.int32, np.uint8, np.bool_)


def test_nobody_and_nothing_is_a_town_too() -> None:
    traffic, (ego, path) = begin(0, 0, 0)
    traffic.step(0.1, ego, path)
    assert len(traffic.actors) == 0
    assert traffic.advise(ego, path) > 0.0


def dual_carriageway() -> Town:
    """Two lanes of 1,500 m side by side."""
    x = np.linspace(0.0, 1500.0, 1501)
    lanes = [np.column_stack([x, np.full_like(x, y), np.zeros_like(x)]) for y in (0.0, -3.5)]
    return Town("dual", (Lane(0, lanes[0], 3.5, 25.0, right=1), Lane(1, lanes[1], 3.5, 25.0, left=0)), ())


def test_fast_vehicles_change_lanes_to_pass_slow_ones_safely() -> None:
    town = dual_carriageway()
    traffic = Traffic(town)
    ego, path = ego_on(town, [0], 1490.0)
    ego.y = 500.0
    traffic.reset(np.random.default_rng(3), 30, 0, ego, path)
    cars = traffic._fleet.cars[:-1]
    cars["eager"] = np.where(np.arange(30) % 3 == 0, 0.4, 1.0)
    first = traffic._fleet.path[:30, 0].copy()
    changed, sideways = np.zeros(30, np.bool_), 0.0
    for _ in range(300):
        y = traffic.actors.y.copy()
        traffic.step(0.1, ego, path)
        changed |= traffic._fleet.path[:30, 0] != first
        sideways = max(sideways, float(np.abs(traffic.actors.y - y).max()))
        for i, j in near(traffic, 14.0):
            assert not overlap(box(traffic.actors, i), box(traffic.actors, j))
    assert changed.sum() >= 3
    assert sideways < 0.5  # Metres in a tenth of a second: they glide over.
