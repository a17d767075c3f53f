"""Frames drawn from the real world: what depends on what, and views from elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, ObservationConfig
from me3bev_cli.perception.frames import THINGS, Frames, FrameSource, Job
from me3bev_cli.perception.truth import classes_of
from me3bev_plugins.simulator.highway import Highway

SEEN = ObservationConfig(height=16, width=32, cameras=("front", "back"))


def source(**changed: Any) -> FrameSource:
    settings = {"every": 4, "noise": 0.0, "depth": None, **changed}
    return FrameSource(Highway(Highway.Config()), SEEN, "low", None, **settings)


def drawn(steps: int = 12, **changed: Any) -> Frames:
    made = source(**changed)
    try:
        return made(Job((3, "frames"), steps, "T1"))
    finally:
        made.close()


def test_a_jobs_frames_are_the_same_again() -> None:
    one, other = drawn(noise=0.3, roam=0.5), drawn(noise=0.3, roam=0.5)
    np.testing.assert_array_equal(one.images, other.images)
    np.testing.assert_array_equal(one.maps, other.maps)


def test_disturbances_change_the_drive_and_roaming_what_is_seen() -> None:
    plain, disturbed, elsewhere = drawn(steps=45), drawn(steps=45, noise=0.3), drawn(roam=1.0)
    np.testing.assert_array_equal(plain.images[0], disturbed.images[0])
    assert (plain.images[11] != disturbed.images[11]).any()
    assert all((plain.maps[n] != elsewhere.maps[n]).mean() > 0.05 for n in range(3))


def test_nobody_looks_from_inside_a_thing() -> None:
    maps = classes_of(drawn(every=1, roam=1.0).maps)
    assert not np.isin(maps[:, 95:105, 95:105], THINGS).any()


@pytest.fixture
def world() -> Iterator[Any]:
    env = Highway(Highway.Config()).make_env(SEEN, map="T3", density="low", images=False)
    env.reset(seed=2)
    yield env.unwrapped
    env.close()


def test_a_view_from_where_the_ego_is_is_its_own(world: Any) -> None:
    view = world.look_from(0.0, 0.0, 0.0)
    depth, classes = world.camera_truth()
    np.testing.assert_array_equal(view.depth, depth)
    np.testing.assert_array_equal(view.classes, classes)
    np.testing.assert_array_equal(view.bev, world.bev_semantics())


def test_the_map_moves_against_the_place_and_turns_against_the_turn(world: Any) -> None:
    road = BEV_CLASSES.index("road")
    here = world.bev_semantics() == road
    ahead = world.look_from(10.0, 0.0, 0.0).bev == road
    assert (here[20:150] == ahead[40:170]).mean() > 0.97  # 10 m are 20 cells, and rows run backwards
    left = world.look_from(0.0, 5.0, 0.0).bev == road
    assert (here[:, 20:150] == left[:, 30:160]).mean() > 0.97
    turned = world.look_from(0.0, 0.0, np.pi / 2).bev == road
    assert (np.rot90(here, -1) == turned).mean() > 0.97


def test_a_larger_world_is_larger_on_the_map_and_farther_away(world: Any) -> None:
    road = BEV_CLASSES.index("road")
    here, large = world.bev_semantics() == road, world.look_from(0.0, 0.0, 0.0, 2.0).bev == road
    grown = here[50:150, 50:150].repeat(2, 0).repeat(2, 1)
    assert (grown == large).mean() > 0.95
    # The ground is as far away as ever: the cameras stand as high above it as they did.
    depth = world.camera_truth()[0][:, -1]
    np.testing.assert_allclose(world.look_from(0.0, 0.0, 0.0, 2.0).depth[:, -1], depth, rtol=1e-3)


def test_another_dress_has_the_same_streets_and_traffic_under_other_clothes(world: Any) -> None:
    """Where asphalt or its paint was it is still; sidewalks, lines and houses differ from dress to dress."""
    street = [BEV_CLASSES.index(name) for name in ("road", "lane_marking", "crosswalk", "vehicle")]
    own = world.look_from(0.0, 0.0, 0.0)
    views = [world.look_from(0.0, 0.0, 0.0, 1.0, dress) for dress in range(1, world.dresses + 1)]
    for view in views:
        assert (np.isin(view.bev, street) >= np.isin(own.bev, street)).mean() > 0.99
        vehicle = BEV_CLASSES.index("vehicle")
        np.testing.assert_array_equal(view.bev == vehicle, own.bev == vehicle)
    for name in ("sidewalk", "lane_marking", "building"):
        counts = {int((view.bev == BEV_CLASSES.index(name)).sum()) for view in (own, *views)}
        assert len(counts) > 3, name
    again = world.look_from(0.0, 0.0, 0.0, 1.0, 3)
    np.testing.assert_array_equal(again.images, views[2].images)
    assert (again.images != own.images).any()


def test_a_share_of_the_frames_is_seen_in_another_dress() -> None:
    plain, dressed = drawn(steps=16), drawn(steps=16, dress=1.0)
    assert all((plain.maps[n] != dressed.maps[n]).any() for n in range(4))
