"""What frames are learned from: shares of depth, cells in sight, the mirrored world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from me3bev_cli.api import Camera, ObservationConfig, Rig
from me3bev_cli.perception.truth import (
    BODY,
    SLACK,
    DepthBins,
    Sight,
    classes_of,
    mirrored_cameras,
    packed,
    seen_in,
)

EDGES = (2.0, 4.0, 8.0)


def test_the_shares_of_a_feature_cell_are_its_pixels() -> None:
    depth = np.full((1, 4, 8), np.inf, np.float32)
    depth[0, :, :4] = 3.0
    depth[0, 0, :4] = 5.0
    depth[0, :2, 4:] = 2.0  # a border belongs to the bin that begins there; the other half is sky
    shares = DepthBins(EDGES, (1, 2), (4, 8)).shares(depth)
    assert shares.shape == (1, 2, 1, 2)
    assert shares[0, :, 0, 0].tolist() == [255 * 12 // 16, 255 * 4 // 16]
    assert shares[0, :, 0, 1].tolist() == [255 * 8 // 16, 0]


def test_features_at_the_border_may_hold_less_of_the_image() -> None:
    """7 pixels at stride 4 are two cells."""
    depth = np.full((2, 7, 7), 3.0, np.float32)
    depth[1, 4:] = 9.0  # beyond the bins
    shares = DepthBins(EDGES, (2, 2), (7, 7)).shares(depth)
    assert (shares[0, 0] == 255).all()
    assert (shares[1, 0, 0] == 255).all()
    assert (shares[1, :, 1] == 0).all()


def a_rig(turned: float = 0.3) -> Rig:
    lens = {"width": 40, "height": 24, "fx": 30.0, "fy": 30.0, "cx": 20.0, "cy": 9.0}
    return Rig(
        cameras=(
            Camera(name="a", yaw=turned, position=(1.0, 0.5, 1.7), **lens),  # type: ignore[arg-type]
            Camera(name="b", yaw=-turned, position=(1.0, -0.5, 1.7), **lens),  # type: ignore[arg-type]
        )
    )


def seen_by_hand(
    rig: Rig, depth: NDArray[np.float32], classes: NDArray[np.uint8], bev: NDArray[np.uint8], row: int, column: int
) -> bool:
    """One cell, by trigonometry."""
    x, y = 50 - 0.5 * (row + 0.5), 50 - 0.5 * (column + 0.5)
    for index, camera in enumerate(rig.cameras):
        dx, dy = x - camera.position[0], y - camera.position[1]
        ahead = dx * math.cos(camera.yaw) + dy * math.sin(camera.yaw)
        right = dx * math.sin(camera.yaw) - dy * math.cos(camera.yaw)
        if ahead <= 0.1:
            continue
        u = camera.fx * right / ahead + camera.cx
        v = camera.fy * camera.position[2] / ahead + camera.cy
        if not (0 <= u < camera.width and 0 <= v < camera.height):
            continue
        there = float(depth[index, int(v), int(u)])
        if 1 / there <= 1 / ahead + SLACK / (camera.fy * camera.position[2]):
            return True
        if classes[index, int(v), int(u)] == bev[row, column] and there >= ahead - BODY:
            return True
    return False


def test_sight_is_that_of_a_search_cell_by_cell() -> None:
    rng = np.random.default_rng(0)
    rig = a_rig()
    depth = rng.choice([3.0, 6.0, 15.0, 40.0, np.inf], (2, 24, 40)).astype(np.float32)
    classes = rng.integers(0, 3, (2, 24, 40), np.uint8)
    bev = rng.integers(0, 3, (200, 200), np.uint8)
    seen = Sight(rig)(depth, classes, bev)
    for row, column in rng.integers(0, 200, (3000, 2)).tolist():
        assert seen[row, column] == seen_by_hand(rig, depth, classes, bev, row, column), (row, column)
    ahead = [(row, 100) for row in range(100)]
    assert {bool(seen[cell]) for cell in ahead} == {True, False}


def test_class_and_sight_share_a_byte() -> None:
    bev, seen = np.arange(8, dtype=np.uint8), np.arange(8) % 3 == 0
    both = packed(bev, seen)
    np.testing.assert_array_equal(classes_of(both), bev)
    np.testing.assert_array_equal(seen_in(both), seen)


def test_the_mirrored_world_is_seen_by_the_cameras_of_the_other_side() -> None:
    from me3bev_plugins.simulator.highway.rig import surround_rig

    assert mirrored_cameras(surround_rig(ObservationConfig())) == (2, 1, 0, 5, 4, 3)
    assert mirrored_cameras(a_rig()) == (1, 0)
    assert mirrored_cameras(Rig(cameras=a_rig().cameras[:1])) is None
    off_centre = [camera.model_copy(update={"cx": 18.0}) for camera in a_rig().cameras]
    assert mirrored_cameras(Rig(cameras=tuple(off_centre))) is None


@pytest.mark.parametrize("cells", [(8, 22), (2, 6)])
def test_bins_take_any_stride(cells: tuple[int, int]) -> None:
    shares = DepthBins(EDGES, cells, (64, 176)).shares(np.full((1, 64, 176), 7.0, np.float32))
    assert (shares[0, 1] == 255).all()
