"""Every metric against figures worked out by hand."""

from __future__ import annotations

import math

import pytest
from episodes import episode

from me3bev_cli.evaluation.metrics import METRICS, PAPER, collisions, measure, penalty


def value(name: str, drive: object) -> float:
    return METRICS[name].function(drive)  # type: ignore[arg-type]


NONE = [""] * 4


def test_the_table_describes_itself() -> None:
    assert PAPER == (
        "collision_rate", "similarity", "timesteps", "waypoint_distance", "efficiency", "comfort", "driving_score",
    )  # fmt: skip
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.version >= 1
        assert all((metric.label, metric.unit, metric.formula, metric.source))
        assert metric.direction in ("higher", "lower", "neither")
    assert set(measure(episode())) == set(METRICS)


def test_collision_rate_is_one_for_any_kind_of_collision() -> None:
    assert value("collision_rate", episode(4)) == 0
    for kind in ("vehicle", "pedestrian", "static"):
        assert value("collision_rate", episode(5, collision=[*NONE, kind])) == 1


def test_a_collision_by_another_is_not_the_egos() -> None:
    hit = [*NONE, "vehicle"]
    assert value("at_fault_collision_rate", episode(5, collision=hit)) == 0
    assert value("at_fault_collision_rate", episode(5, collision=hit, at_fault=[False] * 4 + [True])) == 1
    # A flag without a collision says nothing.
    assert value("at_fault_collision_rate", episode(5, at_fault=True)) == 0


def test_contact_over_several_steps_is_one_collision() -> None:
    drive = episode(7, collision=["", "vehicle", "vehicle", "", "vehicle", "static", ""])
    assert collisions(drive) == {"vehicle": 2, "pedestrian": 0, "static": 1}
    assert collisions(episode(2, collision=["pedestrian", "pedestrian"])) == {
        "vehicle": 0, "pedestrian": 1, "static": 0,
    }  # fmt: skip


def test_means_over_steps() -> None:
    drive = episode(
        4, similarity=[1, 0.5, -0.5, 0], waypoint_distance=[1, 2, 3, 6], speed=[0, 2, 4, 6], reward=[1, 1, -6, 0]
    )
    assert value("similarity", drive) == 0.25
    assert value("waypoint_distance", drive) == 3.0
    assert value("mean_speed", drive) == 3.0
    assert value("return_per_step", drive) == -1.0
    assert value("timesteps", drive) == 4


def test_efficiency_is_the_ratio_of_mean_speeds_while_others_are_near() -> None:
    nan = math.nan
    # Steps 2 and 3: own mean (4 + 8) / 2 = 6, theirs (2 + 6) / 2 = 4.
    assert value("efficiency", episode(4, speed=[99, 4, 8, 99], traffic_speed=[nan, 2, 6, nan])) == 1.5
    assert math.isnan(value("efficiency", episode(4, traffic_speed=nan)))
    assert math.isnan(value("efficiency", episode(4, traffic_speed=0.0)))
    # 5 / 0.5 = 10 still counts; 5 / 0.4 = 12.5 is dropped.
    assert value("efficiency", episode(4, speed=5, traffic_speed=0.5)) == 10
    assert math.isnan(value("efficiency", episode(4, speed=5, traffic_speed=0.4)))


def test_route_completion_is_the_farthest_point() -> None:
    assert value("route_completion", episode(3, route_done=[10, 40, 35], route_length=80)) == 0.5
    assert value("route_completion", episode(3, route_done=[10, 40, 79.9], route_length=80, ended="finished")) == 1
    assert value("route_completion", episode(1, route_done=-3, route_length=80)) == 0
    assert math.isnan(value("route_completion", episode(1, route_length=0)))


def test_lane_departures_are_counted() -> None:
    assert value("lane_departures", episode(5, lane_departure=[True, False, False, True, False])) == 2
    assert value("lane_departures", episode(5)) == 0


def test_off_road_goes_by_distance() -> None:
    # 2 + 6 of 2 + 6 + 4 + 4 = 16 metres per 0.1 s.
    drive = episode(4, speed=[2, 6, 4, 4], off_road=[True, True, False, False])
    assert value("off_road", drive) == 0.5
    assert value("off_road", episode(4, speed=0, off_road=True)) == 0


@pytest.mark.parametrize(
    ("columns", "factor"),
    [
        ({}, 1.0),
        ({"collision": [*NONE, "pedestrian"]}, 0.5),
        ({"collision": [*NONE, "vehicle"]}, 0.6),
        ({"collision": [*NONE, "static"]}, 0.65),
        ({"red_light": [True, False, True, False, False]}, 0.7 * 0.7),
        ({"stop_sign": [False, True, False, False, False]}, 0.8),
        ({"off_road": [True, False, False, False, False]}, 0.8),
        (
            {"collision": [*NONE, "vehicle"], "red_light": [True] + [False] * 4, "off_road": [False] * 3 + [True] * 2},
            0.6 * 0.7 * 0.6,
        ),
    ],
)
def test_driving_score_is_completion_times_penalties(columns: dict[str, list[object]], factor: float) -> None:
    drive = episode(5, route_done=[5, 10, 15, 20, 25], route_length=100, **columns)
    assert penalty(drive) == pytest.approx(factor)
    assert value("driving_score", drive) == pytest.approx(25 * factor)


def test_success_needs_the_whole_route_and_no_penalty() -> None:
    assert value("success", episode(5, "finished")) == 1
    assert value("success", episode(5, "timeout")) == 0
    assert value("success", episode(5, "finished", red_light=[True] + [False] * 4)) == 0
    assert value("success", episode(5, "finished", off_road=[True] + [False] * 4)) == 0


def test_counts_of_infractions() -> None:
    drive = episode(4, red_light=[True, False, True, False], stop_sign=[False, False, True, False])
    assert value("red_lights", drive) == 2
    assert value("stop_signs", drive) == 1


def test_paper_score_rewards_standing_still() -> None:
    assert value("paper_score", episode(128, speed=0, route_done=0)) == 100
    assert value("driving_score", episode(128, speed=0, route_done=0)) == 0
    assert value("paper_score", episode(64, "collision", collision=[""] * 63 + ["vehicle"])) == pytest.approx(30)
    assert value("paper_score", episode(64, "finished")) == 50
    assert value("paper_score", episode(300)) == 100


def test_comfort_is_the_share_of_whole_segments_that_pass() -> None:
    # Three segments of 20 and a rest of 5: gentle, braking at 5 m/s^2, gentle; the rest is not looked at.
    acceleration = [1.0] * 20 + [-5.0] * 20 + [1.0] * 20 + [-9.0] * 5
    assert value("comfort", episode(65, acceleration=acceleration)) == pytest.approx(2 / 3)
    assert math.isnan(value("comfort", episode(19)))
