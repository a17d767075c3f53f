"""Calibration per frame: the rig's own changes nothing, a jittered one is what the naive formula gives."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch
from torch import Tensor

from me3bev_cli.api import Calibration, Camera, Rig
from me3bev_cli.testing_spatial import jittered, rig_calibration
from me3bev_plugins.spatial.lift_splat import LiftSplat

SPACE: dict[str, Any] = {
    "depth_range": (2.0, 12.0),
    "x_range": (-8.0, 8.0),
    "y_range": (-8.0, 8.0),
    "z_range": (-2.0, 3.0),
    "cell": 1.0,
}
SMALL: dict[str, Any] = SPACE | {
    "trunk": "tiny",
    "stride": 8,
    "neck": None,
    "depth_bins": 5,
    "channels": 3,
    "bev_channels": (4, 6, 8),
    "bev_blocks": 1,
    "token_rows": 2,
    "token_columns": 2,
    "token_width": 5,
}


def make(rig: Rig, **keys: Any) -> LiftSplat:
    torch.manual_seed(0)
    return LiftSplat(LiftSplat.Config(**(SMALL | keys)), rig)


def turned_rig(rig: Rig, seed: int) -> Rig:
    """The rig with other angles, positions and focal lengths."""
    drawn = torch.randn(len(rig.cameras), 6, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    cameras = []
    for camera, (yaw, pitch, x, y, z, focal) in zip(rig.cameras, drawn.tolist(), strict=True):
        ahead, left, up = camera.position
        changed = {
            "yaw": camera.yaw + 0.05 * yaw,
            "pitch": camera.pitch + 0.03 * pitch,
            "position": (ahead + 0.1 * x, left + 0.1 * y, up + 0.1 * z),
            "fx": camera.fx * (1 + 0.03 * focal),
        }
        cameras.append(Camera(**(camera.model_dump() | changed)))
    return Rig(cameras=tuple(cameras))


def joined(rigs: list[Rig]) -> Calibration:
    """One frame per rig."""
    parts = [rig_calibration(rig, 1) for rig in rigs]
    return Calibration(*(torch.cat(tables) for tables in zip(*parts, strict=True)))


def inputs(frames: int, cameras: int) -> tuple[Tensor, Tensor]:
    torch.manual_seed(1)
    probability = torch.randn(frames, cameras, 5, 4, 6, dtype=torch.float64).softmax(2)
    context = torch.randn(frames, cameras, 3, 4, 6, dtype=torch.float64)
    return probability.requires_grad_(), context.requires_grad_()


@pytest.mark.parametrize("cameras", [1, 2, 3, 4, 5, 6, 7, 8])
def test_jittered_calibration_equals_the_lifted_tensor(cameras: int) -> None:
    """Each frame with a rig of its own: sums and gradients of the naive formula, frame by frame."""
    nominal = naive.rig(cameras)
    rigs = [turned_rig(nominal, seed) for seed in range(3)]
    probability, context = inputs(3, cameras)
    grid = make(nominal).pool(probability, context, joined(rigs))
    frames = [
        naive.lift_splat(rig, probability[n : n + 1], context[n : n + 1], stride=8, **SPACE)
        for n, rig in enumerate(rigs)
    ]
    expected = torch.cat(frames).flatten(2).transpose(1, 2)
    naive.assert_same(grid, expected, (probability, context))


def test_float32_within_1e_5() -> None:
    nominal = naive.rig()
    calibration = joined([turned_rig(nominal, seed) for seed in range(2)])
    probability, context = inputs(2, 6)
    module = make(nominal)
    exact = module.pool(probability, context, calibration)
    single = module.pool(probability.float(), context.float(), calibration)
    torch.testing.assert_close(single.double(), exact, rtol=1e-5, atol=1e-5)
    weights = torch.randn(exact.shape, dtype=torch.float64)
    right = torch.autograd.grad((exact * weights).sum(), (probability, context))
    given = torch.autograd.grad((single * weights.float()).sum(), (probability, context))
    for mine, theirs in zip(given, right, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-5, atol=1e-5)


def test_the_rigs_own_calibration_changes_nothing() -> None:
    """Every output and every parameter's gradient, in float64."""
    rig = naive.rig()
    module = make(rig, ground_samples=2).double()
    images = torch.randn(3, 6, 3, 32, 48, dtype=torch.float64)
    fixed, given = module(images), module(images, rig_calibration(rig, 3))
    torch.testing.assert_close(tuple(given), tuple(fixed), rtol=1e-9, atol=1e-12)
    parameters = list(module.parameters())
    right = torch.autograd.grad(sum(part.sin().sum() for part in fixed), parameters)
    mine = torch.autograd.grad(sum(part.sin().sum() for part in given), parameters)
    torch.testing.assert_close(mine, right, rtol=1e-8, atol=1e-11)


def test_a_jittered_frame_is_what_a_module_of_that_rig_gives() -> None:
    """The ground plane included: the module of each rig, with the same weights."""
    nominal = naive.rig(4)
    rigs = [turned_rig(nominal, seed) for seed in range(2)]
    images = torch.randn(2, 4, 3, 32, 48)
    given = make(nominal)(images, joined(rigs))
    for frame, rig in enumerate(rigs):
        alone = make(rig)(images[frame : frame + 1])
        for mine, theirs in zip(given, alone, strict=True):
            torch.testing.assert_close(mine[frame : frame + 1], theirs, rtol=1e-4, atol=1e-4)


def test_the_order_of_jittered_cameras_does_not_matter() -> None:
    rig = naive.rig()
    order = [4, 2, 0, 5, 1, 3]
    turned = Rig(cameras=tuple(rig.cameras[index] for index in order))
    calibration = jittered(rig_calibration(rig, 2), 0)
    images = torch.randn(2, 6, 3, 32, 48)
    expected = make(rig)(images, calibration)
    given = make(turned)(images[:, order], Calibration(*(part[:, order] for part in calibration)))
    torch.testing.assert_close(given.tokens, expected.tokens, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(given.grid, expected.grid, rtol=1e-4, atol=1e-5)


def test_extrinsics_moved_by_whole_cells_move_the_grid() -> None:
    """Two metres ahead and one to the left: two rows up, one column back."""
    rig = naive.rig()
    module = make(rig)
    probability, context = inputs(1, 6)
    fixed = rig_calibration(rig, 1)
    moved = fixed.extrinsics.clone()
    moved[..., 0, 3] += 2.0
    moved[..., 1, 3] += 1.0
    before = module.pool(probability, context).view(16, 16, 3)
    after = module.pool(probability, context, fixed._replace(extrinsics=moved)).view(16, 16, 3)
    torch.testing.assert_close(after[:-2, :-1], before[2:, 1:], rtol=1e-9, atol=1e-12)


def test_calibration_may_be_float32() -> None:
    rig = naive.rig()
    module = make(rig)
    images = torch.randn(1, 6, 3, 32, 48)
    single = Calibration(*(part.float() for part in rig_calibration(rig, 1)))
    torch.testing.assert_close(module(images, single).tokens, module(images).tokens, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("images", "change", "message"),
    [
        ((2, 5, 3, 32, 48), None, r"images of shape \(2, 5, 3, 32, 48\); this rig gives \('N', 6, 3, 32, 48\)"),
        ((2, 6, 3, 32, 56), None, r"this rig gives"),
        ((2, 6, 3, 32, 48), "frames", r"intrinsics of shape \(1, 6, 3, 3\); these images need \(2, 6, 3, 3\)"),
        ((2, 6, 3, 32, 48), "extrinsics", r"extrinsics of shape \(2, 6, 3, 4\); these images need \(2, 6, 4, 4\)"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(images: tuple[int, ...], change: str | None, message: str) -> None:
    rig = naive.rig()
    calibration = rig_calibration(rig, 1 if change == "frames" else 2)
    if change == "extrinsics":
        calibration = calibration._replace(extrinsics=calibration.extrinsics[:, :, :3])
    with pytest.raises(ValueError, match=message):
        make(rig)(torch.randn(images), calibration if change else None)
