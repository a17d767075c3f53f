"""An encoder that keeps its contract passes, and one that breaks a promise is told which."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from fakes import TinyGrid, TinySpatial
from torch import Tensor, nn

from me3bev_cli.api import Calibration, GridSpec, Rig, SpatialOutput, TokenSpec
from me3bev_cli.errors import PluginError
from me3bev_cli.testing import check_plugin


class WrongSpec(TinySpatial):
    @classmethod
    def output_spec(cls, config: Any, rig: Rig) -> TokenSpec:
        return TokenSpec(2, 2, 5)


class BatchStatistics(TinySpatial):
    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        self.norm = nn.BatchNorm1d(4)

    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(self.norm(super().forward(images).tokens))


class SeesNeighbours(TinySpatial):
    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(super().forward(images - images.mean(0)).tokens)


class StaysBehind(TinySpatial):
    """Keeps a tensor that no device finds."""

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        self.scale = torch.ones(8)

    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(super().forward(images).tokens * self.scale)


class GoesHome(TinySpatial):
    """Computes on the CPU, wherever it is."""

    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(super().forward(images.cpu()).tokens)


class ComesBack(TinySpatial):
    """Adds something that is on the CPU."""

    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(super().forward(images).tokens + torch.ones(8, device="cpu"))


class SinglePrecision(TinySpatial):
    def forward(self, images: Tensor) -> SpatialOutput:
        return SpatialOutput(super().forward(images).tokens.float())


class Overflows(TinySpatial):
    """Right in float32; loses all digits in bf16."""

    def forward(self, images: Tensor) -> SpatialOutput:
        tokens = super().forward(images).tokens
        return SpatialOutput((tokens + 1e4 * tokens.sign()) - 1e4 * tokens.sign())


class Lifts(TinySpatial):
    """Makes the whole tensor of features at every depth."""

    bins = 7

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        self.depth = nn.Conv2d(3, self.bins, 8, stride=8)
        self.register_buffer("depth_edges", torch.arange(1.0, self.bins + 2), persistent=False)
        self.context = nn.Conv2d(3, 8, 8, stride=8)

    def forward(self, images: Tensor) -> SpatialOutput:
        tokens = super().forward(images).tokens
        flat = images.flatten(0, 1)
        logits, context = self.depth(flat), torch.tanh(self.context(flat))
        lifted = logits.softmax(1).unsqueeze(1) * context.unsqueeze(2)
        pooled = lifted.unflatten(0, images.shape[:2]).mean((1, 3, 4, 5))
        return SpatialOutput(tokens + pooled[:, None], None, logits.unflatten(0, images.shape[:2]))


class Turned(TinySpatial):
    """Counts cameras after bins."""

    def forward(self, images: Tensor) -> SpatialOutput:
        logits = images.mean(2)[:, :, None].expand(-1, -1, 2, -1, -1).transpose(1, 2)
        return SpatialOutput(super().forward(images).tokens, None, logits)


class Borderless(TinyGrid):
    """Does not say where its depth bins lie."""

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        del self.depth_edges


class OtherGrid(TinyGrid):
    """Promises a coarser grid than it gives."""

    @classmethod
    def grid_spec(cls, config: Any, rig: Rig) -> GridSpec:
        return super().grid_spec(config, rig)._replace(rows=10)


class UntoldGrid(TinySpatial):
    """Gives a grid that nobody was told of."""

    def forward(self, images: Tensor) -> SpatialOutput:
        return super().forward(images)._replace(grid=images.mean((1, 2))[:, None])


class Calibrated(TinySpatial):
    """Adds what its cameras' positions are on average."""

    def __init__(self, config: Any, rig: Rig) -> None:
        super().__init__(config, rig)
        self.register_buffer("extrinsics", torch.tensor([c.camera_to_ego() for c in rig.cameras]), persistent=False)

    def forward(self, images: Tensor, calibration: Calibration | None = None) -> SpatialOutput:
        extrinsics = self.extrinsics[None] if calibration is None else self.given(calibration)
        return SpatialOutput(super().forward(images).tokens + extrinsics[:, :, 0, 3].mean(1)[:, None, None].to(images))

    def given(self, calibration: Calibration) -> Tensor:
        return calibration.extrinsics


class FirstFrames(Calibrated):
    """Takes the first frame's calibration for all."""

    def given(self, calibration: Calibration) -> Tensor:
        return calibration.extrinsics[:1]


class OtherWay(Calibrated):
    """Takes the calibration for its inverse."""

    def given(self, calibration: Calibration) -> Tensor:
        return torch.linalg.inv(calibration.extrinsics) + 1


def test_an_encoder_that_takes_calibration_passes() -> None:
    check_plugin("spatial", Calibrated)


@pytest.mark.parametrize(
    ("cls", "promise"),
    [
        (StaysBehind, "all tensors follow the module across devices. Seen: .scale does not"),
        (GoesHome, "the module computes where it is"),
        (ComesBack, "the module computes where it is"),
        (SinglePrecision, "float64 in, float64 out"),
        (Overflows, "bf16 autocast stays within 10% of float32"),
        (Lifts, "are never lifted to every depth bin. Seen: a tensor with 8 numbers for each point"),
        (Turned, "depth_logits has the cameras as second axis"),
        (Borderless, "a plugin with depth_logits has depth_edges, one more than bins. Seen: None"),
        (OtherGrid, "the grid's shape is (6, 10, 20), as grid_spec says. Seen: (6, 20, 20)"),
        (UntoldGrid, "a plugin has grid_spec if it gives a grid"),
        (FirstFrames, "a frame's output does not depend on the others"),
        (OtherWay, "the rig's calibration given per frame changes nothing"),
        (WrongSpec, "the tokens' shape is (3, 4, 5)"),
        (BatchStatistics, "a forward pass leaves the module's state_dict as it is"),
        (SeesNeighbours, "a frame's output does not depend on the others"),
    ],
)
def test_a_broken_encoder_is_told_what_it_breaks(cls: type, promise: str) -> None:
    check_plugin("spatial", TinySpatial)
    with pytest.raises(PluginError) as caught:
        check_plugin("spatial", cls)
    assert promise in str(caught.value)
