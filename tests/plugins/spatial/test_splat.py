"""The splat against the naive lifted tensor: numbers, gradients, geometry, memory."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch
from torch import Tensor

from me3bev_cli.api import Camera, Rig
from me3bev_cli.testing_spatial import Allocations
from me3bev_plugins.spatial import splat as splat_module
from me3bev_plugins.spatial.frustum import Grid, calibration, cells_of, depth_edges, frustum
from me3bev_plugins.spatial.splat import SplatIndex, build_index, splat

STRIDE, BINS, CHANNELS = 8, 5, 3
SPACE: dict[str, Any] = {
    "depth_range": (2.0, 12.0),
    "x_range": (-8.0, 10.0),
    "y_range": (-9.0, 9.0),
    "z_range": (-0.5, 3.0),
    "cell": 1.5,
}
GRID = Grid(SPACE["x_range"], SPACE["y_range"], SPACE["z_range"], SPACE["cell"])


def index_of(rig: Rig, grid: Grid = GRID, stride: int = STRIDE, bins: int = BINS) -> SplatIndex:
    height, width = rig.image_size
    edges = depth_edges(*SPACE["depth_range"], bins)
    points = frustum(*calibration(rig), (height // stride, width // stride), stride, (edges[1:] + edges[:-1]) / 2)
    return build_index(cells_of(points, grid), grid.rows * grid.columns)


def inputs(rig: Rig, frames: int = 2, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
    """Probabilities (N, C, D, h, w) and context (N, C, channels, h, w)."""
    torch.manual_seed(0)
    h, w = (size // STRIDE for size in rig.image_size)
    cameras = len(rig.cameras)
    probability = torch.randn(frames, cameras, BINS, h, w, dtype=dtype).softmax(2)
    return probability.requires_grad_(), torch.randn(frames, cameras, CHANNELS, h, w, dtype=dtype).requires_grad_()


def ours(rig: Rig, probability: Tensor, context: Tensor) -> Tensor:
    vectors = context.permute(0, 1, 3, 4, 2).reshape(len(context), -1, CHANNELS)
    cells = splat(probability.flatten(1), vectors, index_of(rig))
    return cells.view(len(cells), GRID.rows, GRID.columns, CHANNELS).permute(0, 3, 1, 2)


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("cameras", [1, 6, 8])
def test_equals_the_lifted_tensor(cameras: int, fused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums and both gradients, by torch's fused kernel and by the way for devices without it."""
    if not fused:
        monkeypatch.setattr(splat_module, "fused", lambda table: False)
        monkeypatch.setattr(splat_module, "_BLOCK", 50)
    rig = naive.rig(cameras)
    probability, context = inputs(rig)
    grid = ours(rig, probability, context)
    expected = naive.lift_splat(rig, probability, context, stride=STRIDE, **SPACE)
    naive.assert_same(grid, expected, (probability, context))


def test_float32_is_near_float64() -> None:
    rig = naive.rig()
    probability, context = inputs(rig)
    exact = ours(rig, probability, context)
    single = ours(rig, probability.float(), context.float())
    torch.testing.assert_close(single.double(), exact, rtol=1e-5, atol=1e-5)


def test_the_order_of_the_cameras_does_not_matter() -> None:
    rig = naive.rig()
    probability, context = inputs(rig)
    order = [3, 0, 5, 1, 4, 2]
    turned = Rig(cameras=tuple(rig.cameras[i] for i in order))
    grid = ours(turned, probability[:, order], context[:, order])
    torch.testing.assert_close(grid, ours(rig, probability, context), rtol=1e-12, atol=1e-12)


def test_cameras_moved_by_whole_cells_move_the_grid() -> None:
    """Two cells ahead and one to the left: two rows up, one column back."""
    near, moved = naive.rig(), naive.rig(shift=(2 * SPACE["cell"], SPACE["cell"]))
    probability, context = inputs(near)
    before, after = ours(near, probability, context), ours(moved, probability, context)
    torch.testing.assert_close(after[:, :, :-2, :-1], before[:, :, 2:, 1:], rtol=1e-9, atol=1e-12)


def test_a_point_by_hand() -> None:
    """A camera that looks ahead from (0, 0, 1): half a focal length right of its axis and 4 m deep is (4, -2, 1)."""
    camera = Camera(name="c", width=16, height=8, fx=8, fy=8, cx=0, cy=4, position=(0, 0, 1), yaw=0.0)
    points = frustum(*calibration(Rig(cameras=(camera,))), (1, 1), 8, torch.tensor([4.0]).double())
    # The middle of the one cell of 8 pixels is at u = v = 4: half a focal length right, on the axis' height.
    assert points.flatten().tolist() == pytest.approx([4.0, -2.0, 1.0])
    grid = Grid((0.0, 8.0), (-4.0, 4.0), (0.0, 2.0), 1.0)
    # 4 m ahead is the border of rows 3 and 4 and belongs to the farther-counted 4; y = -2 begins column 6.
    assert cells_of(points, grid).item() == 4 * 8 + 6


@pytest.mark.parametrize(
    ("point", "inside"),
    [
        ((9.99, 0.0, 0.0), True),
        ((10.01, 0.0, 0.0), False),
        ((-8.01, 0.0, 0.0), False),
        ((0.0, 9.01, 0.0), False),
        ((0.0, -9.01, 0.0), False),
        ((0.0, 0.0, 3.01), False),
        ((0.0, 0.0, -0.51), False),
        ((0.0, 0.0, 2.99), True),
    ],
)
def test_points_outside_are_dropped(point: tuple[float, float, float], inside: bool) -> None:
    assert (cells_of(torch.tensor(point, dtype=torch.float64), GRID).item() >= 0) == inside


@pytest.mark.parametrize("fused", [True, False])
def test_nothing_is_ever_lifted(fused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forward and backward at 41 bins and 64 channels stay far below C x D x h x w x channels numbers."""
    if not fused:
        monkeypatch.setattr(splat_module, "fused", lambda table: False)
        monkeypatch.setattr(splat_module, "_BLOCK", 500)
    rig, bins, channels = naive.rig(height=64, width=96), 41, 64
    index = index_of(rig, bins=bins)
    pixels = 6 * 8 * 12
    probability = torch.rand(1, pixels * bins, requires_grad=True)
    context = torch.rand(1, pixels, channels, requires_grad=True)
    with Allocations() as made:
        splat(probability, context, index).square().sum().backward()
    assert 0 < made.largest < pixels * bins * channels / 16


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("frames", [1, 3])
def test_a_camera_that_sees_nothing_of_the_grid(frames: int, fused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """It looks ahead, the grid lies behind: zeros, and gradients of zero."""
    if not fused:
        monkeypatch.setattr(splat_module, "fused", lambda table: False)
    rig = Rig(cameras=naive.rig().cameras[:1])
    grid = Grid((-60.0, -40.0), (-9.0, 9.0), (-0.5, 3.0), 1.0)
    index = index_of(rig, grid)
    assert len(index.cell) == 0
    probability = torch.rand(frames, BINS * 4 * 6, requires_grad=True)
    context = torch.randn(frames, 4 * 6, CHANNELS, requires_grad=True)
    cells = splat(probability, context, index)
    assert cells.shape == (frames, 20 * 18, CHANNELS)
    cells.sum().backward()
    assert not any(part.any() for part in (cells, probability.grad, context.grad) if part is not None)


def test_tables_outgrow_int32_where_they_must(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a limit that three frames pass, they are counted in int64 and come to the same."""
    rig = naive.rig(2)
    probability, context = inputs(rig, 3)
    expected = ours(rig, probability, context)
    assert index_of(rig).entry.dtype == torch.int32
    monkeypatch.setattr(splat_module, "_INT32", 2 * BINS * 4 * 6 + 1)
    assert index_of(rig).entry.dtype == torch.int32
    assert splat_module._kind(3 * 2 * BINS * 4 * 6) == torch.int64
    given = ours(rig, probability, context)
    torch.testing.assert_close(given, expected)
    for mine, theirs in zip(
        *(torch.autograd.grad(x.square().sum(), (probability, context)) for x in (given, expected)), strict=True
    ):
        torch.testing.assert_close(mine, theirs)
