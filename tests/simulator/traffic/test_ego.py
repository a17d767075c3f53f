"""The ego is one more vehicle: others make way for it, and `advise` drives it as they drive."""

from __future__ import annotations

import numpy as np
import pytest
from simulator.tiny_town import build_tiny_town
from simulator.traffic.stage import bind, box, ego_box, ego_on, overlap, set_lights, staged, straight_town
from simulator.traffic.test_conflicts import connector

from me3bev_plugins.simulator.highway.ego_path import EgoPath
from me3bev_plugins.simulator.highway.scene import Light
from me3bev_plugins.simulator.highway.town import Lane, Town
from me3bev_plugins.simulator.highway.traffic import Traffic
from me3bev_plugins.simulator.highway.traffic_tables import tables

TOWN = build_tiny_town()


def ride(
    traffic: Traffic, town: Town, lanes: list[int], s: float, speed: float, steps: int
) -> list[tuple[float, float]]:
    """(metres from the start, speed) of an ego that does what it is advised, exactly on its route."""
    log, travelled, index = [], 0.0, 0
    for _ in range(steps):
        lane = town.lanes[lanes[index]]
        ego, path = ego_on(town, lanes[index:], s, speed)
        path = EgoPath(np.array(lanes, np.int32), index, s, 0.0)
        accel = traffic.advise(ego, path)
        assert -8.0 <= accel <= 3.5
        s, travelled = s + speed * 0.1, travelled + speed * 0.1
        speed = max(0.0, speed + accel * 0.1)
        if s >= lane.length and index + 1 < len(lanes):
            s, index = s - lane.length, index + 1
        ego, _ = ego_on(town, lanes[index:], s, speed)
        traffic.step(0.1, ego, EgoPath(np.array(lanes, np.int32), index, s, 0.0))
        for i in range(len(traffic.actors)):
            assert not overlap(box(traffic.actors, i), ego_box(ego))
        log.append((travelled, speed))
    return log


def test_traffic_stops_behind_a_standing_ego() -> None:
    town = straight_town(400.0, 15.0)
    ego, path = ego_on(town, [0], 200.0)
    traffic = staged(town, [(0, 60.0, 15.0), (0, 85.0, 12.0)])
    for _ in range(250):
        traffic.step(0.1, ego, path)
    gap = (ego.x - ego.length / 2) - (traffic.actors.x[1] + 2.5)
    assert traffic.actors.speed.max() < 0.05
    assert 1.0 < gap < 6.0


@pytest.mark.parametrize(("lateral", "turned"), [(1.5, 0.0), (-1.6, 0.5), (0.0, np.pi / 2), (2.0, np.pi / 2)])
def test_traffic_stops_for_an_ego_that_stands_in_its_way_at_any_angle(lateral: float, turned: float) -> None:
    town = straight_town(400.0, 15.0)
    ego, path = ego_on(town, [0], 200.0, lateral=lateral)
    ego.heading += turned
    traffic = staged(town, [(0, 80.0, 15.0)])
    for _ in range(250):
        traffic.step(0.1, ego, path)
        assert not overlap(box(traffic.actors, 0), ego_box(ego))
    assert traffic.actors.speed[0] < 0.05


@pytest.mark.parametrize(("lateral", "z"), [(4.0, 0.0), (0.0, 6.0)])
def test_an_ego_beside_or_above_the_road_is_no_obstacle(lateral: float, z: float) -> None:
    town = straight_town(400.0, 15.0)
    ego, path = ego_on(town, [0], 200.0, lateral=lateral)
    ego.z = z
    traffic = staged(town, [(0, 80.0, 15.0)])
    for _ in range(150):
        traffic.step(0.1, ego, path)
    assert traffic.actors.x[0] > 220.0


def test_an_ego_that_cuts_in_is_braked_for() -> None:
    town = straight_town(600.0, 15.0)
    traffic = staged(town, [(0, 100.0, 14.0)])
    for k in range(200):
        ego, path = ego_on(town, [0], 115.0 + 0.7 * k, speed=7.0)  # Comes in 10 m ahead at half the speed.
        traffic.step(0.1, ego, path)
        assert not overlap(box(traffic.actors, 0), ego_box(ego))
    assert traffic.actors.speed[0] == pytest.approx(7.0, abs=1.0)


def test_an_ego_inside_a_junction_is_not_driven_into() -> None:
    across = connector(TOWN, 16, "straight")
    straight = connector(TOWN, 8, "straight")
    ego, path = ego_on(TOWN, [across, 18], 10.0)
    traffic = staged(TOWN, [(8, 5.0, 9.0), (9, 5.0, 9.0)])
    bind(traffic, 0, [8, straight, 12])
    bind(traffic, 1, [9, connector(TOWN, 9, "straight"), 13])
    set_lights(traffic, Light.GREEN)
    for _ in range(250):
        traffic.step(0.1, ego, path)
        for i in (0, 1):
            assert not overlap(box(traffic.actors, i), ego_box(ego))
    assert (traffic.actors.speed < 0.1).all()
    assert (traffic.actors.x < 1.75).all()


def test_advice_stops_for_red_and_goes_on_green() -> None:
    lanes = [8, connector(TOWN, 8, "straight"), 12]
    traffic = staged(TOWN, [])
    set_lights(traffic, Light.RED)
    log = ride(traffic, TOWN, lanes, 5.0, 0.0, 128)
    stop = float(tables(TOWN).roads.lanes["stop"][8])
    assert log[-1][1] < 0.1
    assert stop - 4.0 < 5.0 + log[-1][0] + 2.35 <= stop
    set_lights(traffic, Light.GREEN)
    assert ride(traffic, TOWN, lanes, 5.0, 0.0, 128)[-1][0] > 70.0


def test_advice_stops_behind_a_leader() -> None:
    town = straight_town(400.0, 15.0)
    traffic = staged(town, [(0, 150.0, 0.0)])
    traffic._fleet.cars["eager"][0] = 0.0
    log = ride(traffic, town, [0], 20.0, 0.0, 250)
    assert max(speed for _, speed in log) > 8.0
    assert log[-1][1] < 0.2
    gap = (traffic.actors.x[0] - 2.5) - (20.0 + log[-1][0] + 2.35)
    assert gap == pytest.approx(5.0, abs=1.0)


def test_advice_obeys_the_limit_and_slows_down_for_bends() -> None:
    town = straight_town(2000.0, 13.0)
    log = ride(staged(town, []), town, [0], 20.0, 0.0, 200)
    assert max(speed for _, speed in log) <= 13.05
    assert log[-1][1] > 12.5
    turn = connector(TOWN, 16, "right")
    traffic = staged(TOWN, [])
    set_lights(traffic, Light.GREEN)
    ego, path = ego_on(TOWN, [16, turn], 2.0, speed=11.0)
    assert traffic.advise(ego, path) < -1.0  # The bend begins 24 m ahead.


def test_asking_for_advice_changes_nothing() -> None:
    def play(ask: bool) -> bytes:
        ego, path = ego_on(TOWN, [8, connector(TOWN, 8, "straight"), 12], 20.0)
        traffic = Traffic(TOWN)
        traffic.reset(np.random.default_rng(5), 12, 12, ego, path)
        states = []
        for _ in range(80):
            if ask:
                traffic.advise(ego, path)
            traffic.step(0.1, ego, path)
            states.append(traffic._pose.tobytes())
        return b"".join(states)

    assert play(True) == play(False)


def test_traffic_leaves_an_ego_with_the_right_of_way_its_turn() -> None:
    # Both come up to an equal junction in the south; the ego is nearer and comes first.
    south = [i for i in range(20) if TOWN.lanes[TOWN.lanes[i].successors[0]].junction == 2]
    mine, theirs = south[0], south[1]
    ahead = TOWN.lanes[mine].successors[0]
    traffic = staged(TOWN, [(theirs, TOWN.lanes[theirs].length - 30.0, 6.0)])
    lanes = [mine, ahead, TOWN.lanes[ahead].successors[0]]
    log = ride(traffic, TOWN, lanes, TOWN.lanes[mine].length - 14.0, 5.0, 60)
    assert log[-1][0] > 25.0
    assert min(speed for _, speed in log[:20]) > 3.0


@pytest.mark.parametrize("speed", [4.0, 9.0])
def test_an_ego_that_comes_against_the_traffic_is_braked_for(speed: float) -> None:
    town = straight_town(600.0, 15.0)
    traffic = staged(town, [(0, 100.0, 14.0)])
    x = 260.0
    for _ in range(300):
        x -= 0.1 * speed
        ego, path = ego_on(town, [0], x, speed)
        ego.heading = np.pi
        traffic.step(0.1, ego, path)
        if overlap(box(traffic.actors, 0), ego_box(ego)):
            break
    # The ego drives into a car that stands.
    assert traffic.actors.speed[0] < 0.1


def test_an_ego_that_turns_round_in_the_road_stops_both_directions() -> None:
    both = straight_town(400.0, 15.0)
    back = both.lanes[0].points[::-1] + np.array([0.0, 4.0, 0.0])
    town = Town("both", (both.lanes[0], Lane(1, back, 4.0, 15.0)), ())
    traffic = staged(town, [(0, 80.0, 15.0), (1, 80.0, 15.0)])
    ego, path = ego_on(town, [0], 200.0, lateral=2.0)
    ego.heading = np.pi / 2
    for _ in range(250):
        traffic.step(0.1, ego, path)
        assert not any(overlap(box(traffic.actors, i), ego_box(ego)) for i in (0, 1))
    assert (traffic.actors.speed < 0.05).all()
