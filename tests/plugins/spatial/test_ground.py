"""The ground-plane view: a world whose colour is a linear function of the ground point comes back exactly."""

from __future__ import annotations

import naive_lift_splat as naive
import torch

from me3bev_cli.api import Rig
from me3bev_plugins.spatial.frustum import Grid
from me3bev_plugins.spatial.ground import Sampling, ground_index, warp

GRID = Grid((-8.0, 8.0), (-6.0, 6.0), (-1.0, 1.0), 1.0)


def pixels_of(rig: Rig) -> torch.Tensor:
    """Images whose red is the camera's index, green u and blue v of the pixel's centre: (1, C * H * W, 3)."""
    height, width = rig.image_size
    v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    images = [torch.stack([torch.full_like(u, index), u, v], dim=-1) for index in range(len(rig.cameras))]
    return torch.stack(images).view(1, -1, 3)


def test_every_seen_point_is_read_where_it_lies_in_the_image() -> None:
    """The pixel position that comes back leads through the naive geometry to the ground point."""
    rig = naive.rig(height=64, width=96)
    view = warp(pixels_of(rig), ground_index(rig, GRID, Sampling(1)))[0].double()
    points = GRID.centres().view(-1, 2)
    checked = 0
    for (index, u, v, seen), (x, y) in zip(view.tolist(), points.tolist(), strict=True):
        if not seen or not (0.51 < u < 95.49 and 0.51 < v < 63.49):
            continue
        camera = rig.cameras[round(index)]
        unit = naive.point(camera, u, v, 1.0)
        scale = camera.position[2] / (camera.position[2] - unit[2])
        found = [camera.position[axis] + scale * (unit[axis] - camera.position[axis]) for axis in (0, 1)]
        assert abs(found[0] - x) < 0.02 + 0.002 * abs(x) * abs(scale)
        assert abs(found[1] - y) < 0.02 + 0.002 * abs(y) * abs(scale)
        checked += 1
    assert checked > 60


def test_what_no_camera_sees_is_black_and_marked() -> None:
    """One camera that looks ahead sees nothing behind itself."""
    rig = Rig(cameras=naive.rig().cameras[:1])
    view = warp(pixels_of(rig) + 1.0, ground_index(rig, GRID, Sampling(2)))[0].view(16, 12, 13)
    assert view[8:].abs().max() == 0
    assert view[:7, 5:7, 12].max() == 1


def test_samples_of_a_cell_follow_each_other() -> None:
    """Cells of 2 x 2 samples hold what a grid of half the cell holds."""
    rig = naive.rig(height=64, width=96)
    coarse = warp(pixels_of(rig), ground_index(rig, GRID, Sampling(2)))[0, :, :12].view(16, 12, 2, 2, 3)
    fine = warp(pixels_of(rig), ground_index(rig, GRID._replace(cell=0.5), Sampling(1)))[0, :, :3].view(16, 2, 12, 2, 3)
    torch.testing.assert_close(coarse, fine.transpose(1, 2))


def test_the_order_of_the_cameras_does_not_matter() -> None:
    rig = naive.rig()
    order = [3, 0, 5, 1, 4, 2]
    turned = Rig(cameras=tuple(rig.cameras[i] for i in order))
    images = torch.rand(1, 6, 32 * 48, 3)
    expected = warp(images.view(1, -1, 3), ground_index(rig, GRID, Sampling(1)))
    torch.testing.assert_close(
        warp(images[:, order].reshape(1, -1, 3), ground_index(turned, GRID, Sampling(1))), expected
    )


def test_the_colour_of_a_piece_is_the_mean_of_its_points() -> None:
    """Points of a piece that are seen, as finer pieces tell them; each pixel is read once."""
    rig = naive.rig(height=64, width=96)
    images = torch.rand(1, 6 * 64 * 96, 3)
    index = ground_index(rig, GRID, Sampling(2, 3))
    means = warp(images, index)[0, :, :12].view(16, 12, 2, 2, 3)
    fine = warp(images + 1.0, ground_index(rig, GRID, Sampling(6)))[0, :, :108].view(16, 12, 2, 3, 2, 3, 3)
    seen = (fine.sum(-1, keepdim=True) > 0).double()
    points = ((fine - 1.0) * seen).sum((3, 5)) / seen.sum((3, 5)).clamp(min=1)
    torch.testing.assert_close(means.double(), points.double(), atol=1e-5, rtol=0)
    ends = torch.cat([index.offsets[1:], torch.tensor([len(index.pixel)])])
    for start, end in list(zip(index.offsets.tolist(), ends.tolist(), strict=True))[::37]:
        pixels = index.pixel[start:end]
        assert len(pixels.unique()) == len(pixels)
