"""The whole aggregator: its parts joined as the formula says, and what it refuses."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch
from pydantic import ValidationError
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from me3bev_cli.api import Rig
from me3bev_plugins.spatial.bev_trunk import BEVTrunk
from me3bev_plugins.spatial.lift_splat import LiftSplat
from me3bev_plugins.spatial.trunks import Trunk

SMALL: dict[str, Any] = {
    "trunk": "tiny",
    "stride": 8,
    "neck": None,
    "depth_range": (2.0, 12.0),
    "depth_bins": 5,
    "channels": 3,
    "x_range": (-8.0, 8.0),
    "y_range": (-8.0, 8.0),
    "cell": 1.0,
    "bev_channels": (4, 6, 8),
    "bev_blocks": 1,
    "token_rows": 2,
    "token_columns": 4,
    "token_width": 7,
}


def make(rig: Rig, **keys: Any) -> LiftSplat:
    torch.manual_seed(0)
    return LiftSplat(LiftSplat.Config(**(SMALL | keys)), rig)


def test_the_grid_holds_the_depth_weighted_context() -> None:
    """What the bird's-eye trunk is given, against the naive lifted tensor of the same logits and context."""
    rig = naive.rig()
    module = make(rig, ground_plane=False).double()
    seen: list[torch.Tensor] = []
    module.bev_trunk.register_forward_pre_hook(lambda _, args: seen.append(args[0]))
    heads: list[torch.Tensor] = []
    module.head.register_forward_hook(lambda _, args, out: heads.append(out))
    output = module(torch.randn(2, 6, 3, 32, 48, dtype=torch.float64))
    logits, context = heads[0].split([5, 3], dim=1)
    torch.testing.assert_close(output.depth_logits, logits.unflatten(0, (2, 6)))
    expected = naive.lift_splat(
        rig, logits.unflatten(0, (2, 6)).softmax(2), context.unflatten(0, (2, 6)), stride=8,
        depth_range=(2.0, 12.0), x_range=(-8.0, 8.0), y_range=(-8.0, 8.0), z_range=(-10.0, 10.0), cell=1.0,
    )  # fmt: skip
    torch.testing.assert_close(seen[0], expected, rtol=1e-9, atol=1e-12)


def test_shapes() -> None:
    rig = naive.rig(3)
    output = make(rig)(torch.randn(2, 3, 3, 32, 48))
    assert output.tokens.shape == (2, 8, 7)
    assert output.grid is not None
    assert output.grid.shape == (2, 4, 8, 8)
    assert output.depth_logits is not None
    assert output.depth_logits.shape == (2, 3, 5, 4, 6)


def test_the_order_of_the_cameras_does_not_matter() -> None:
    rig = naive.rig()
    order = [2, 5, 0, 1, 4, 3]
    turned = Rig(cameras=tuple(rig.cameras[i] for i in order))
    images = torch.randn(1, 6, 3, 32, 48)
    expected, given = make(rig)(images), make(turned)(images[:, order])
    torch.testing.assert_close(given.tokens, expected.tokens, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(given.grid, expected.grid, rtol=1e-4, atol=1e-5)


def test_depth_edges_span_the_range() -> None:
    module = make(naive.rig())
    assert module.depth_edges.tolist() == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    full = LiftSplat.Config()
    assert (full.depth_bins, full.depth_range) == (41, (4.0, 45.0))
    assert (full.grid().rows, full.grid().columns) == (200, 200)


def test_tables_of_the_geometry_are_not_saved() -> None:
    assert not [name for name in make(naive.rig()).state_dict() if "splat_" in name or "ground_" in name]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"x_range": (-8.0, 8.3)}, r"x_range: 16.3 cells of 1.0 m; a whole number"),
        ({"depth_range": (12.0, 2.0)}, r"depth_range: 12.0 must be below 2.0"),
        ({"depth_range": (0.0, 2.0)}, r"depth_range: 0.0 must be positive"),
    ],
)
def test_ranges_that_do_not_fit_are_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        LiftSplat.Config(**(SMALL | keys))


def test_more_tokens_than_the_map_has_are_refused() -> None:
    with pytest.raises(ValueError, match="5 x 4 tokens are more than a quarter of the grid's 16 x 16 cells"):
        LiftSplat.output_spec(LiftSplat.Config(**(SMALL | {"token_rows": 5})), naive.rig())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"trunk": "resnet81"}, "unknown trunk 'resnet81'; did you mean 'resnet18'"),
        ({"stride": 32}, "'tiny' has no features at stride 32"),
        ({"stride": 16, "neck": 8}, "'tiny' has no features at stride 32"),
        ({"trunk": "vit_b_16"}, "'vit_b_16' cannot be a trunk"),
    ],
)
def test_a_trunk_that_does_not_fit_is_refused_before_anything_is_made(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LiftSplat.output_spec(LiftSplat.Config(**(SMALL | keys)), naive.rig())


def test_cameras_of_two_sizes_are_refused() -> None:
    mixed = Rig(cameras=(naive.rig().cameras[0], naive.rig(height=64).cameras[1]))
    with pytest.raises(ValueError, match="must all have one size"):
        LiftSplat.output_spec(LiftSplat.Config(**SMALL), mixed)


def test_the_grids_trunk_costs_less_than_the_cameras() -> None:
    """At full size, in multiply-adds: it sees 40,000 cells where the cameras have 1,056 feature cells."""
    rig = naive.rig(height=128, width=352)
    with torch.device("meta"):
        trunk = Trunk("efficientnet_b0", 16, neck=128)
        config = LiftSplat.Config()
        tokens = config.tokens()
        ground = 3 * config.ground_samples**2 + 1
        bev = BEVTrunk(config.channels + ground, config.bev_channels, config.bev_blocks, tokens)
        images, grid = torch.zeros(len(rig.cameras), 3, 128, 352), torch.zeros(1, config.channels + ground, 200, 200)
        costs = []
        for module, x in ((trunk, images), (bev, grid)):
            with FlopCounterMode(display=False) as counter:
                module(x)
            costs.append(counter.get_total_flops())
    assert costs[1] < 0.7 * costs[0]


def test_tokens_are_a_grid_over_the_map() -> None:
    """What lies ahead changes the tokens of the first row, what lies behind those of the last."""
    config = LiftSplat.Config(**(SMALL | {"token_rows": 4, "token_columns": 4}))
    torch.manual_seed(0)
    # Receptive fields are wide: without normalisation, which looks at the whole map, most stays where it is.
    trunk = BEVTrunk(3, (4, 6, 8), 1, config.tokens()).double()
    for module in trunk.modules():
        if isinstance(module, nn.GroupNorm):
            module.forward = lambda x: x  # type: ignore[method-assign]
    grid = torch.zeros(1, 3, 64, 64, dtype=torch.float64)
    plain = trunk(grid)[0].view(4, 4, -1)
    for row, column in ((0, 0), (3, 3)):
        marked = grid.clone()
        marked[:, :, 16 * row + 6 : 16 * row + 10, 16 * column + 6 : 16 * column + 10] = 1.0
        change = (trunk(marked)[0].view(4, 4, -1) - plain).abs().sum(-1)
        assert change.argmax() == 4 * row + column
        assert change[3 - row, 3 - column] == 0


def test_a_stretch_moves_the_grid_before_anything_is_computed_on_it() -> None:
    """A stretch that changes nothing gives what no stretch gives; one that mirrors the rows sees ahead behind."""
    rig = naive.rig(height=64, width=96)
    module = make(rig, x_range=(-16.0, 16.0), y_range=(-16.0, 16.0), bev_stride=1).eval()
    images = torch.randn(2, 6, 3, 64, 96)
    with torch.inference_mode():
        plain = module(images)
        assert plain.grid is not None
        rows = LiftSplat.grid_spec(module.config, rig).rows
        own = ((torch.arange(rows) + 0.5) * 2 / rows - 1).expand(2, 2, rows)
        same = module(images, stretch=own)
        torch.testing.assert_close(same.tokens, plain.tokens, atol=1e-4, rtol=1e-4)
        mirrored = module(images, stretch=torch.stack([-own[:, 0], own[:, 1]], 1))
    assert mirrored.grid is not None
    assert (mirrored.grid - plain.grid.flip(2)).abs().mean() < (mirrored.grid - plain.grid).abs().mean()
    torch.testing.assert_close(mirrored.depth_logits, plain.depth_logits)
