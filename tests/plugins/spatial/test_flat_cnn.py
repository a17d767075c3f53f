"""The flat network: one trunk for all cameras, pooled and joined; three cameras as the baseline has."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch

from me3bev_cli.api import Rig
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_plugins.spatial.flat_cnn import FlatCNN


def make(rig: Rig, **keys: Any) -> FlatCNN:
    torch.manual_seed(0)
    return FlatCNN(FlatCNN.Config(**keys), rig)


@pytest.mark.parametrize(
    ("trunk", "channels"),
    [("shufflenet_v2_x0_5", 1024), ("shufflenet_v2_x1_0", 1024), ("resnet18", 512), ("resnet50", 2048)],
)
def test_variants(trunk: str, channels: int) -> None:
    module = make(naive.rig(3), trunk=trunk, width=8)
    assert module.linear.in_features == 3 * channels
    output = module(torch.randn(2, 3, 3, 32, 48))
    assert output.tokens.shape == (2, 1, 8)
    assert output.grid is None
    assert output.depth_logits is None


def test_one_trunk_sees_each_camera_apart() -> None:
    """Pooled features of each image alone, side by side, through the linear layer."""
    module = make(naive.rig(3), trunk="resnet18", width=8).double()
    images = torch.randn(2, 3, 3, 32, 48, dtype=torch.float64)
    pooled = [module.trunk(images[:, camera]).mean((2, 3)) for camera in range(3)]
    expected = module.linear(torch.cat(pooled, 1))
    torch.testing.assert_close(module(images).tokens[:, 0], expected)


def test_more_cameras_take_no_second_trunk() -> None:
    sizes = [sum(p.numel() for p in make(naive.rig(n), trunk="tiny", width=8).trunk.parameters()) for n in (1, 8)]
    assert sizes[0] == sizes[1]


def test_the_baseline_has_three_cameras() -> None:
    recipe = resolve_recipe("e2e_cla")
    assert recipe.observation.cameras == ("front_left", "front", "front_right")
    assert isinstance(spatial := build_network(recipe, 0).spatial, FlatCNN)
    assert spatial.cameras == 3


def test_every_parameter_learns() -> None:
    module = make(naive.rig(2), trunk="shufflenet_v2_x0_5", width=8)
    module(torch.randn(2, 2, 3, 64, 64)).tokens.square().sum().backward()
    assert [name for name, p in module.named_parameters() if p.grad is None] == []
