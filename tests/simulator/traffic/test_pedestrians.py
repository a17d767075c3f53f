"""Pedestrians stay off the road until they cross it, and nobody walks into a car."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import FAR_AWAY, box, corners, ego_box, ego_on, overlap, set_lights, staged

from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.pedestrian_kernel import CROSS, STROLL, WAIT
from me3bev_plugins.simulator.highway.scene import Kind, Light
from me3bev_plugins.simulator.highway.town import Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_stress import stress
from me3bev_plugins.simulator.highway.traffic_tables import tables

TOWN = build_tiny_town()
AWAY = ego_on(TOWN, [0], 5.0)[1]


def crossing_of(town: Town, governed: bool) -> int:
    """The marked crossing with or without a light."""
    crossings = tables(town).walks.crossings
    lit = crossings["signal1"] > crossings["signal0"]
    return int(np.flatnonzero((crossings["marked"] == 1) & (lit == governed))[0])


def with_person(traffic: Traffic, crossing: int, mode: int = WAIT) -> None:
    """Put one pedestrian at the first end of a crossing."""
    other = Traffic(TOWN)
    other.reset(np.random.default_rng(0), len(traffic._fleet.cars) - 1, 1, FAR_AWAY, AWAY)
    traffic._people = other._people
    traffic._pose = np.zeros((5, len(traffic._fleet.cars)))
    braking = np.zeros(len(traffic._fleet.cars), np.bool_)
    for name, row in zip(("x", "y", "z", "heading", "speed"), traffic._pose, strict=True):
        setattr(traffic.actors, name, row)
    traffic.actors.braking = braking
    for name in ("length", "width"):
        size = getattr(traffic.actors, name)
        setattr(traffic.actors, name, np.append(size, 0.5))
    person, record = traffic._people[0], tables(TOWN).walks.crossings[crossing]
    person["mode"], person["crossing"], person["way"], person["along"] = mode, crossing, 1, 0.0
    person["x"], person["y"], person["z"], person["aside"] = record["x0"], record["y0"], 0.0, 0.0
    person["pace"], person["wait"] = 1.4, 0.0


def first_link(crossing: int) -> tuple[int, float, float]:
    """(lane, arc length on it, metres along the crossing) of the first lane that is met."""
    t = tables(TOWN)
    k = int(t.walks.met[t.walks.crossings[crossing]["met0"]])
    lane = next(i for i, record in enumerate(t.roads.lanes) if record["cross0"] <= k < record["cross1"])
    return lane, float(t.roads.links[k]["s"]), float(t.roads.links[k]["along"])


def far_from_lanes(x: float, y: float) -> float:
    """Metres from the edge of the nearest lane."""
    return min(
        float(np.hypot(lane.points[:, 0] - x, lane.points[:, 1] - y).min()) - lane.width / 2 for lane in TOWN.lanes
    )


def test_both_crosswalks_are_found_with_the_lanes_they_cross() -> None:
    t = tables(TOWN)
    for governed, lanes in ((True, {8, 9, 10, 11}), (False, {0, 1})):
        c = crossing_of(TOWN, governed)
        record = t.walks.crossings[c]
        links = t.walks.met[record["met0"] : record["met1"]]
        met = {i for i, lane in enumerate(t.roads.lanes) for k in links if lane["cross0"] <= k < lane["cross1"]}
        assert met == lanes
    offsets = sorted(float(t.roads.links[k]["along"]) for k in links)
    assert offsets[1] - offsets[0] == pytest.approx(3.5, abs=0.1)


def test_nobody_begins_on_a_road() -> None:
    traffic = Traffic(TOWN)
    traffic.reset(np.random.default_rng(1), 0, 150, FAR_AWAY, AWAY)
    actors = traffic.actors
    assert (actors.kind == Kind.PEDESTRIAN).sum() == 150
    assert min(far_from_lanes(x, y) for x, y in zip(actors.x, actors.y, strict=True)) > 0.0


def test_strollers_stay_off_the_road() -> None:
    traffic = Traffic(TOWN)
    traffic.reset(np.random.default_rng(2), 0, 60, FAR_AWAY, AWAY)
    crossed = 0
    for k in range(600):
        traffic.step(0.1, FAR_AWAY, AWAY)
        crossed += int((traffic._people["mode"] == CROSS).sum())
        if k % 20 == 0:
            for person in traffic._people[traffic._people["mode"] == STROLL]:
                assert far_from_lanes(float(person["x"]), float(person["y"])) > -0.6
    assert crossed > 100


def test_at_a_light_they_wait_for_red() -> None:
    traffic = staged(TOWN, [])
    with_person(traffic, crossing_of(TOWN, True))
    set_lights(traffic, Light.GREEN)
    for _ in range(100):
        traffic.step(0.1, FAR_AWAY, AWAY)
    assert traffic._people[0]["mode"] == WAIT
    set_lights(traffic, Light.RED)
    for _ in range(20):
        traffic.step(0.1, FAR_AWAY, AWAY)
    assert traffic._people[0]["mode"] == CROSS


def test_vehicles_stop_for_somebody_who_waits_at_a_crosswalk_and_the_crossing_is_finished() -> None:
    crossing = crossing_of(TOWN, False)
    record = tables(TOWN).walks.crossings[crossing]
    start = float(TOWN.lanes[1].length) * 0.2
    traffic = staged(TOWN, [(0, 5.0, 10.0), (0, 25.0, 10.0), (1, start, 10.0)])
    with_person(traffic, crossing)
    done = -1
    for k in range(300):
        traffic.step(0.1, FAR_AWAY, AWAY)
        for i in range(3):
            assert not overlap(box(traffic.actors, i), box(traffic.actors, 3))
        if done < 0 and np.hypot(traffic.actors.x[3] - record["x1"], traffic.actors.y[3] - record["y1"]) < 1.0:
            done = k
    assert 0 < done < 200


def test_nobody_walks_into_the_side_of_a_car() -> None:
    crossing = crossing_of(TOWN, False)
    lane, s, _ = first_link(crossing)
    ego, path = ego_on(TOWN, [lane], s)  # Stands on the crosswalk for ever.
    traffic = staged(TOWN, [])
    with_person(traffic, crossing, CROSS)
    for _ in range(300):
        traffic.step(0.1, ego, path)
        assert not overlap(box(traffic.actors, 0), ego_box(ego))


@pytest.mark.parametrize("near", [0.9, 0.4, 0.15])
def test_who_has_a_car_at_the_elbow_does_not_walk_on_into_it(near: float) -> None:
    # The tail of a car that turned beside somebody had swung out to within the room that a body needs.
    crossing = crossing_of(TOWN, False)
    lane, s, along = first_link(crossing)
    ego, path = ego_on(TOWN, [lane], s)
    traffic = staged(TOWN, [])
    with_person(traffic, crossing, CROSS)
    traffic._people[0]["along"] = along - ego.width / 2 - 0.28 - near
    nearest = np.inf
    for step in range(60):
        traffic.step(0.1, ego, path)
        assert not overlap(box(traffic.actors, 0), ego_box(ego))
        if step == 0:
            first = float(np.hypot(traffic.actors.x[0] - ego.x, traffic.actors.y[0] - ego.y))
        nearest = min(nearest, float(np.hypot(traffic.actors.x[0] - ego.x, traffic.actors.y[0] - ego.y)))
    assert nearest > ego.width / 2 + 0.28
    if near < 0.3:
        assert nearest == first


def test_nobody_steps_before_a_car_that_could_not_stop() -> None:
    crossing = crossing_of(TOWN, False)
    traffic = staged(TOWN, [])
    with_person(traffic, crossing)
    lane, s, _ = first_link(crossing)
    for step in range(60):  # The ego rushes over the crosswalk at 15 m/s and brakes for nobody.
        at = s - 45.0 + 1.5 * step
        if not 0.0 < at < TOWN.lanes[lane].length:
            continue
        ego, path = ego_on(TOWN, [lane], at, speed=15.0)
        traffic.step(0.1, ego, path)
        assert not overlap(box(traffic.actors, 0), ego_box(ego))


def test_the_ego_can_hit_them() -> None:
    traffic = staged(TOWN, [])
    crossing = crossing_of(TOWN, False)
    with_person(traffic, crossing, CROSS)
    record = tables(TOWN).walks.crossings[crossing]
    traffic._people[0]["along"] = record["length"] / 2
    traffic.step(0.1, FAR_AWAY, AWAY)
    x, y = traffic.actors.x[0], traffic.actors.y[0]
    assert overlap(corners(x, y, 0.0, 4.7, 1.9), box(traffic.actors, 0))


def test_advice_stops_for_somebody_on_the_road() -> None:
    crossing = crossing_of(TOWN, False)
    lane, s, along = first_link(crossing)
    traffic = staged(TOWN, [])
    with_person(traffic, crossing, CROSS)
    traffic._people[0]["along"] = along
    traffic._people[0]["pace"] = 0.0
    at, speed = s - 30.0, 9.0
    for _ in range(100):
        ego, path = ego_on(TOWN, [lane], at, speed)
        traffic.step(0.1, ego, path)
        accel = traffic.advise(ego, path)
        at, speed = at + 0.1 * speed, max(0.0, speed + 0.1 * accel)
    assert speed < 0.05
    assert 1.0 < s - (at + ego.length / 2) < 5.0


def loose_crossing() -> int:
    """A place to cross without a crosswalk, with 45 m of road before it."""
    crossings = tables(TOWN).walks.crossings
    return next(int(c) for c in np.flatnonzero(crossings["marked"] == 0) if first_link(int(c))[1] > 45.0)


@pytest.mark.parametrize(("gap", "sets_out"), [(10.0, False), (20.0, False), (None, True)])
def test_without_a_crosswalk_they_leave_a_car_at_the_limit_room_to_stop(gap: float | None, sets_out: bool) -> None:
    crossing = loose_crossing()
    lane, s, _ = first_link(crossing)
    # 11 m/s take 30 m to stop at 2 m/s^2.
    traffic = staged(TOWN, [] if gap is None else [(lane, s - gap, TOWN.lanes[lane].limit)])
    with_person(traffic, crossing)
    traffic.step(0.1, FAR_AWAY, AWAY)
    assert (traffic._people[0]["mode"] == CROSS) == sets_out


def test_a_car_stops_for_somebody_who_lingers_on_the_road_without_a_crosswalk() -> None:
    crossing = loose_crossing()
    lane, s, along = first_link(crossing)
    traffic = staged(TOWN, [(lane, s - 40.0, 9.0)])
    with_person(traffic, crossing, CROSS)
    traffic._people[0]["along"], traffic._people[0]["pace"] = along, 0.0
    for _ in range(120):
        traffic.step(0.1, FAR_AWAY, AWAY)
        assert not overlap(box(traffic.actors, 0), box(traffic.actors, 1))
    assert traffic.actors.speed[0] < 0.1


@pytest.mark.parametrize("name", ["T3", "T4", "T7"])
def test_few_of_the_crossings_are_away_from_crosswalks_and_none_on_motorways(name: str) -> None:
    town = load_town(name)
    walks, roads = tables(town).walks, tables(town).roads
    for lane in town.lanes:
        met = roads.links["crossing"][roads.lanes["cross0"][lane.id] : roads.lanes["cross1"][lane.id]]
        assert not lane.highway or (walks.crossings["marked"][met] == 1).all()
    run = stress(town, 300.0, vehicles=50)
    assert 3 < run.elsewhere < 0.2 * run.crossings
    assert run.hit == run.overlaps == 0
