"""Nothing is ever lifted: forward and backward of the whole aggregator, fixed and jittered calibration."""

from __future__ import annotations

import naive_lift_splat as naive
import pytest
import torch

from me3bev_cli.bench.cumulative_sum import cumulative_sum_splat
from me3bev_cli.testing import small_rig
from me3bev_cli.testing_spatial import Allocations, OneDevice, jittered, rig_calibration
from me3bev_plugins.spatial.lift_splat import LiftSplat

BINS, CHANNELS, FRAMES = 167, 64, 2
POINTS = FRAMES * 6 * BINS * 4 * 6
"""Frames x cameras x bins x h x w; each would hold a vector of CHANNELS numbers."""


def make() -> LiftSplat:
    torch.manual_seed(0)
    config = LiftSplat.Config(
        trunk="tiny", stride=8, neck=None, depth_bins=BINS, channels=CHANNELS, cell=4.0, bev_channels=(8, 8, 8),
        token_rows=2, token_columns=2,
    )  # fmt: skip
    return LiftSplat(config, naive.rig())


@pytest.mark.parametrize("per_frame", [False, True])
def test_no_tensor_of_every_point_and_channel_is_made(per_frame: bool) -> None:
    """The largest holds a few numbers per point: its probability, its place in the ego frame."""
    module = make()
    calibration = [jittered(rig_calibration(naive.rig(), FRAMES), 0)] if per_frame else []
    with Allocations() as made:
        output = module(torch.randn(FRAMES, 6, 3, 32, 48), *calibration)
        (output.tokens.square().sum() + output.grid.square().sum() + output.depth_logits.square().sum()).backward()
    assert 0 < made.largest <= 3 * POINTS
    assert all(parameter.grad is not None for parameter in module.parameters())


def test_nothing_lifted_is_kept_for_the_backward_pass() -> None:
    """What autograd saves, too."""
    module, saved = make(), []
    with torch.autograd.graph.saved_tensors_hooks(lambda x: saved.append(x.numel()) or x, lambda x: x):
        module(torch.randn(FRAMES, 6, 3, 32, 48))
    assert 0 < max(saved) <= 3 * POINTS


def test_the_yardstick_lifts_and_gives_the_same() -> None:
    """The published way makes the tensor that is avoided; its sums and gradients are ours."""
    module = make()
    probability = torch.randn(FRAMES, 6, BINS, 4, 6, dtype=torch.float64).softmax(2).requires_grad_()
    context = torch.randn(FRAMES, 6, CHANNELS, 4, 6, dtype=torch.float64, requires_grad=True)
    with Allocations() as made:
        grid = cumulative_sum_splat(probability, context, module.point_cells(), module.grid.rows * module.grid.columns)
    assert made.largest == POINTS * CHANNELS
    ours = module.pool(probability, context)
    torch.testing.assert_close(ours, grid, rtol=1e-8, atol=1e-9)
    weights = torch.randn(grid.shape, dtype=torch.float64)
    right = torch.autograd.grad((grid * weights).sum(), (probability, context))
    given = torch.autograd.grad((ours * weights).sum(), (probability, context))
    for mine, theirs in zip(given, right, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-6, atol=1e-8)


def test_the_module_computes_where_it_is() -> None:
    """On torch's device without memory: no operation meets a tensor that stayed on the CPU."""
    rig = small_rig()
    module = LiftSplat(LiftSplat.Config(trunk="mobilenet_v3_small", neck=8, cell=2.0), rig).to("meta")
    with OneDevice("meta"), torch.no_grad():
        output = module(torch.zeros(2, 6, 3, 64, 96, device="meta"))
    assert {part.device.type for part in output} == {"meta"}
