"""Every installed plugin keeps its contract, and a plugin that breaks one promise is told which."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pytest
import torch
from fakes import TinySpatial
from pydantic import BaseModel, ConfigDict
from torch import Tensor, nn

from me3bev_cli.api import GROUPS, Calibration, NoConfig, PluginConfig, Rig, SpatialOutput, TokenSpec
from me3bev_cli.errors import PluginError, UserError
from me3bev_cli.testing import check_plugin, small_rig

SMALL: dict[str, dict[str, Any]] = {
    "lift_splat": {
        "trunk": "tiny",
        "stride": 8,
        "neck": 12,
        "cell": 2.0,
        "channels": 6,
        "bev_channels": (8, 8, 12),
        "token_rows": 4,
        "token_columns": 4,
        "token_width": 8,
    },
    "flat_cnn": {"trunk": "tiny", "width": 16},
    "transformer": {"layers": 2, "context": 5},
    "gru": {"layers": 2},
    "lstm": {"hidden": 20},
}
INSTALLED = [
    pytest.param(kind, entry, id=f"{kind}-{entry.name}")
    for kind, group in GROUPS.items()
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)
    if entry.value.startswith("me3bev_plugins.")
]


@pytest.mark.parametrize(("kind", "entry"), INSTALLED)
def test_installed_plugins_keep_their_contract(kind: str, entry: EntryPoint) -> None:
    check_plugin(kind, entry.load(), SMALL.get(entry.name))


@pytest.mark.parametrize("trunk", ["shufflenet_v2_x0_5", "mobilenet_v3_small"])
def test_torchvision_trunks_keep_the_contract(trunk: str) -> None:
    check_plugin("spatial", entry_points(group="me3bev.spatial")["flat_cnn"].load(), {"trunk": trunk, "width": 8})


@pytest.mark.parametrize("name", ["lift_splat", "flat_cnn"])
@pytest.mark.parametrize(
    ("keys", "cameras"), [({"precision": "bf16"}, 6), ({"channels_last": False}, 6), ({}, 1), ({}, 8)]
)
def test_spatial_plugins_keep_it_however_they_compute(name: str, keys: dict[str, Any], cameras: int) -> None:
    cls = entry_points(group="me3bev.spatial")[name].load()
    check_plugin("spatial", cls, SMALL[name] | keys, rig=small_rig(cameras=cameras))


class Decay(nn.Module):
    """A correct memory: m = rate * m + x, y = w m; the fakes below each break one thing."""

    Config = NoConfig

    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__()
        self.width = width
        self.rate = nn.Parameter(torch.full((width,), 0.5))
        self.weight = nn.Parameter(torch.randn(width))

    @classmethod
    def check(cls, config: PluginConfig, width: int) -> None:
        """Any width."""

    def initial_state(self, batch: int) -> Any:
        return (self.rate.new_zeros(batch, self.width),)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        (memory,) = state
        ys = []
        for t in range(x.shape[1]):
            memory = self.rate * self.cleared(memory, starts[:, t]) + x[:, t]
            ys.append(self.weight * memory)
        return torch.stack(ys, 1), (memory,)

    def cleared(self, memory: Tensor, start: Tensor) -> Tensor:
        return memory.masked_fill(start[:, None], 0.0)


class NeverClears(Decay):
    def cleared(self, memory: Tensor, start: Tensor) -> Tensor:
        return memory


class ClearsFirstOnly(Decay):
    """Looks at the start of a call only, as many recurrent policies do."""

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, state, starts & (torch.arange(x.shape[1]) == 0))


class DropsState(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, self.initial_state(len(x)), starts)


class DetachesState(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        return super().forward(x, (state[0].detach(),), starts)


class LooksAhead(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y + x.flip(1).cumsum(1).flip(1), state


class MixesRows(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y + x.mean(0, keepdim=True), state


class LayersFirst(Decay):
    def initial_state(self, batch: int) -> Any:
        return (self.rate.new_zeros(1, batch, self.width),)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, (memory,) = super().forward(x, (state[0][0],), starts)
        return y, (memory[None],)


class StaysOnCpu(Decay):
    def initial_state(self, batch: int) -> Any:
        return (torch.zeros(batch, self.width),)


class ObjectState(Decay):
    def initial_state(self, batch: int) -> Any:
        return {"memory": (self.rate.new_zeros(batch, self.width), "text")}

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, (memory,) = super().forward(x, (state["memory"][0],), starts)
        return y, {"memory": (memory, "text")}


class DeadParameter(Decay):
    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__(config, width)
        self.unused = nn.Parameter(torch.zeros(1))


class DropsOut(Decay):
    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return nn.functional.dropout(y, 0.5, self.training), state


class Unsaved(Decay):
    """Holds a random weight outside its state_dict."""

    def __init__(self, config: PluginConfig, width: int) -> None:
        super().__init__(config, width)
        self.hidden = torch.randn(width)

    def forward(self, x: Tensor, state: Any, starts: Tensor) -> tuple[Tensor, Any]:
        y, state = super().forward(x, state, starts)
        return y * self.hidden, state


class Loose(Decay):
    class Config(PluginConfig):
        model_config = ConfigDict(extra="ignore")


class Foreign(Decay):
    class Config(BaseModel):  # type: ignore[assignment]
        """Not one of ours."""


class NoCheck(Decay):
    check = None  # type: ignore[assignment]


def test_a_correct_memory_passes() -> None:
    check_plugin("temporal", Decay)


@pytest.mark.parametrize(
    ("cls", "promise"),
    [
        (NeverClears, "a start clears the memory inside a sequence"),
        (ClearsFirstOnly, "a sequence frame by frame equals the whole"),
        (DropsState, "a sequence frame by frame equals the whole"),
        (DetachesState, "a sequence frame by frame equals the whole. Seen: gradient"),
        (LooksAhead, "a sequence frame by frame equals the whole"),
        (MixesRows, "sequences are independent of each other"),
        (LayersFirst, "the state has the batch as first axis"),
        (StaysOnCpu, "the state follows the module across devices"),
        (ObjectState, "a plain tree of tensors"),
        (DeadParameter, "gradients flow to every parameter. Seen: none to unused"),
        (DropsOut, "the same input gives the same output"),
        (Unsaved, "a module with a loaded state_dict computes the same"),
        (Loose, "`Config` refuses unknown keys"),
        (Foreign, "`Config` is a subclass of me3bev_cli.api.PluginConfig"),
        (NoCheck, "there is a method `check`"),
    ],
)
def test_a_broken_memory_is_told_what_it_breaks(cls: type, promise: str) -> None:
    with pytest.raises(PluginError) as caught:
        check_plugin("temporal", cls)
    assert f"{cls.__name__} breaks its contract" in str(caught.value)
    assert promise in str(caught.value)


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


class ByOrder(nn.Module):
    """Takes the modalities as they come."""

    Config = NoConfig

    def __init__(self, config: PluginConfig, widths: Mapping[str, int]) -> None:
        super().__init__()
        self.linear = nn.Linear(sum(widths.values()), 6)

    @classmethod
    def output_width(cls, config: PluginConfig, widths: Mapping[str, int]) -> int:
        return 6

    def forward(self, features: Mapping[str, Tensor]) -> Tensor:
        result: Tensor = self.linear(torch.cat(list(features.values()), -1))
        return result


class TooWide(ByOrder):
    @classmethod
    def output_width(cls, config: PluginConfig, widths: Mapping[str, int]) -> int:
        return 7


@pytest.mark.parametrize(
    ("cls", "promise"), [(ByOrder, "modalities are taken by name"), (TooWide, "the result's shape is (5, 7)")]
)
def test_a_broken_fusion_is_told_what_it_breaks(cls: type, promise: str) -> None:
    with pytest.raises(PluginError) as caught:
        check_plugin("fusion", cls)
    assert promise in str(caught.value)


def test_an_unknown_kind() -> None:
    with pytest.raises(UserError, match="unknown kind of plugin 'temporl'; did you mean 'temporal'"):
        check_plugin("temporl", Decay)
