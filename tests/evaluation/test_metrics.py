"""Every metric against figures worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from episodes import episode

from me3bev_cli.evaluation.metrics import FUNCTIONS, METRICS, PAPER, collisions, measure, penalty


def value(name: str, drive: object) -> float:
    return FUNCTIONS[name](drive)  # type: ignore[arg-type]


NONE = [""] * 4
LATER = ("red_met", "background_speed")


def test_the_table_describes_itself() -> None:
    assert PAPER == (
        "collision_rate", "similarity", "timesteps", "waypoint_distance", "efficiency", "comfort", "driving_score",
    )  # fmt: skip
    for name, metric in METRICS.items():
        assert metric.name == name
        assert metric.version >= 1
        assert all((metric.label, metric.unit, metric.formula, metric.source))
        assert metric.direction in ("higher", "lower", "neither")
        assert metric.full_name == f"{name} v{metric.version}"
    assert list(measure(episode())) == list(METRICS)
    assert set(METRICS) == {*FUNCTIONS, "relative_progress"}


def test_collision_rate_is_one_for_any_kind_of_collision() -> None:
    assert value("collision_rate", episode(4)) == 0
    for kind in ("vehicle", "pedestrian", "static"):
        assert value("collision_rate", episode(5, collision=[*NONE, kind])) == 1


@pytest.mark.parametrize("kind", ["vehicle", "pedestrian", "static"])
def test_collision_rates_by_kind(kind: str) -> None:
    drive = episode(5, collision=[*NONE, kind])
    for other in ("vehicle", "pedestrian", "static"):
        assert value(f"{other}_collision_rate", drive) == (other == kind)
        assert value(f"{other}_collision_rate", episode(5)) == 0


def test_the_share_at_fault_is_of_collisions() -> None:
    hits = ["", "vehicle", "vehicle", "", "pedestrian"]
    # Two collisions: the first begins with the other's fault, whatever follows, the second is the ego's.
    assert value("at_fault_share", episode(5, collision=hits, at_fault=[False, False, True, False, True])) == 0.5
    assert value("at_fault_share", episode(5, collision=[*NONE, "static"], at_fault=[False] * 4 + [True])) == 1
    assert math.isnan(value("at_fault_share", episode(5, at_fault=True)))


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


def test_bench2drives_efficiency_by_hand() -> None:
    # Checkpoints lie every 2 m of 40. Each is passed in one step of 2 m but the third, which takes two.
    done = [2, 4, 5, 6]
    drive = episode(4, route_done=done, route_length=40, speed=[8, 6, 3, 3], background_speed=[4, 6, 4, 2])
    # 100 x 8 / 4 = 200; 100 x 6 / 6 = 100; 100 x (3 + 3) / (4 + 2) = 100.
    assert value("efficiency_bench2drive", drive) == pytest.approx(400 / 3)


def test_bench2drives_efficiency_drops_what_is_above_1000_percent() -> None:
    columns = {"route_done": [2, 4], "route_length": 40, "speed": [10, 10]}
    assert value("efficiency_bench2drive", episode(2, **columns, background_speed=[0.9, 5])) == 200
    # Exactly 1000 stays.
    assert value("efficiency_bench2drive", episode(2, **columns, background_speed=[1, 5])) == 600
    assert value("efficiency_bench2drive", episode(2, **columns, background_speed=[0, 5])) == 200
    assert math.isnan(value("efficiency_bench2drive", episode(2, **columns, background_speed=[0.9, 0])))
    assert math.isnan(value("efficiency_bench2drive", episode(2, **columns, background_speed=math.nan)))


def test_bench2drives_efficiency_needs_a_checkpoint() -> None:
    # The first lies at 2 m; the way to the next one is left out.
    short = {"route_length": 40, "speed": 8, "background_speed": 4}
    assert math.isnan(value("efficiency_bench2drive", episode(2, route_done=[1, 1.9], **short)))
    drive = episode(3, route_done=[1, 2, 3.9], route_length=40, speed=[4, 4, 99], background_speed=4)
    assert value("efficiency_bench2drive", drive) == 100
    # Who turns back passes nothing twice.
    back = episode(4, route_done=[2, 1, 2, 2.5], route_length=40, speed=[4, 99, 99, 99], background_speed=4)
    assert value("efficiency_bench2drive", back) == 100
    # The last metre is within the goal's reach.
    end = episode(
        20,
        "finished",
        route_done=[2.0 * i for i in range(1, 20)] + [39.5],
        route_length=40,
        speed=6,
        background_speed=4,
    )
    assert value("efficiency_bench2drive", end) == 150


def test_route_completion_is_the_farthest_point() -> None:
    assert value("route_completion", episode(3, route_done=[10, 40, 35], route_length=80)) == 0.5
    assert value("route_completion", episode(3, route_done=[10, 40, 79.9], route_length=80, ended="finished")) == 1
    assert value("route_completion", episode(1, route_done=-3, route_length=80)) == 0
    assert math.isnan(value("route_completion", episode(1, route_length=0)))


def test_progress_beside_the_autopilots() -> None:
    drive, pilot = episode(3, route_done=[10, 40, 35]), episode(4, route_done=[10, 30, 50, 80])
    assert measure(drive, pilot)["relative_progress"] == 0.5
    assert measure(pilot, drive)["relative_progress"] == 2.0
    assert math.isnan(measure(drive)["relative_progress"])
    assert math.isnan(measure(drive, episode(2, route_done=[0, -1]))["relative_progress"])


def test_reds_run_when_met() -> None:
    met, run = [True, False, True, False, True, False], [False, True, False, False, True, False]
    # Three are met, the first and the last are run.
    assert value("red_light_violation_rate", episode(6, red_met=met, red_light=run)) == pytest.approx(2 / 3)
    assert value("red_light_violation_rate", episode(6, red_met=met)) == 0
    assert math.isnan(value("red_light_violation_rate", episode(6)))


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


def test_an_older_log_says_nothing_about_what_it_lacks() -> None:
    whole = episode(30, red_met=[True] + [False] * 29, background_speed=5)
    older = replace(whole, steps=whole.steps[[n for n in whole.steps.dtype.names if n not in LATER]])
    lost = {name for name, found in measure(older).items() if math.isnan(found) != math.isnan(measure(whole)[name])}
    assert lost == {"red_light_violation_rate", "efficiency_bench2drive"}
