"""Image trunks by name: ours (`tiny`) or any of torchvision's that is a chain of strided stages.

Batch normalisation does not survive in any of them. Batch statistics would make the network that acts
on one frame another than the one that learns from hundreds, so a trunk either has its batch norms
replaced by group norms (training from scratch) or keeps them frozen at the statistics that came with the
pretrained weights. Dropout and stochastic depth are removed for the same reason.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, cast
from urllib.error import URLError

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_cli.errors import PluginError, unknown_name
from me3bev_plugins.spatial.blocks import Residual, conv, group_norm

_PROBE = 128
_LAST = ("avgpool", "fc", "classifier", "head", "heads", "norm", "aux1", "aux2", "AuxLogits")


class FrozenBatchNorm(nn.BatchNorm2d):
    """Batch normalisation that always uses its stored statistics; its scale and shift go on learning."""

    def train(self, mode: bool = True) -> FrozenBatchNorm:
        """Stay in evaluation mode."""
        super().train(False)
        return self


class Trunk(nn.Module):
    """The stages of an image network up to a stride.

    Args:
        name: `tiny` or a torchvision model.
        stride: image pixels per feature cell, a power of two; None for the whole network.
        pretrained: true for torchvision's weights, or a file of weights (.safetensors or a torch file of tensors).
        neck: width of a pyramid neck that adds the next coarser level, upsampled; None for no neck.

    Raises:
        PluginError: for an unknown or unsuitable trunk, or weights that cannot be had.
    """

    def __init__(
        self, name: str, stride: int | None = None, pretrained: bool | str | Path = False, neck: int | None = None
    ) -> None:
        super().__init__()
        stages = _stages(name, pretrained)
        levels = _levels(name, stages)
        last = _last_of(name, levels, stride)
        self.stages = nn.Sequential(*stages[: last + 1])
        self.channels: int = levels[last][1]
        self.coarse: nn.Sequential | None = None
        if neck is not None:
            coarse = _last_of(name, levels, 2 * levels[last][0])
            self.coarse = nn.Sequential(*stages[last + 1 : coarse + 1])
            self.fine_in = nn.Conv2d(self.channels, neck, 1)
            self.coarse_in = nn.Conv2d(levels[coarse][1], neck, 1, bias=False)
            self.merge = nn.Sequential(group_norm(neck), nn.ReLU(), *conv(neck, neck))
            self.channels = neck

    def forward(self, images: Tensor) -> Tensor:
        """Images (M, 3, H, W) -> features (M, channels, h, w)."""
        # The convolutions are faster with the channels innermost, on CPUs and GPUs alike.
        fine: Tensor = self.stages(images.contiguous(memory_format=torch.channels_last))
        if self.coarse is None:
            return fine
        above = cast(Tensor, self.coarse_in(self.coarse(fine)))
        above = F.interpolate(above, size=fine.shape[-2:], mode="bilinear", align_corners=False)
        return cast(Tensor, self.merge(cast(Tensor, self.fine_in(fine)) + above))


def check_trunk(name: str, stride: int | None = None, neck: int | None = None) -> None:
    """Whether there is such a trunk, with features at the stride; takes no memory.

    Raises:
        ValueError: when there is not.
    """
    try:
        with torch.device("meta"):
            Trunk(name, stride, neck=neck)
    except PluginError as error:
        raise ValueError(str(error)) from error


def _tiny() -> list[nn.Module]:
    """Three small stages to strides 4, 8 and 16; the first leaps to 4, since it would cost most at 2."""
    return [
        nn.Sequential(nn.Conv2d(3, 32, 6, 4, 1, bias=False), group_norm(32), nn.ReLU(inplace=True)),
        nn.Sequential(conv(32, 48, 3, 2), Residual(48, 48)),
        nn.Sequential(Residual(48, 96, 2)),
    ]


def _stages(name: str, pretrained: bool | str | Path) -> list[nn.Module]:
    """The network in the order in which an image passes it."""
    if name == "tiny":
        if pretrained is True:
            raise PluginError("the trunk 'tiny' has no published weights", hint="Give a file or set pretrained: false")
        stages = _tiny()
        if pretrained:
            load_weights(nn.Sequential(*stages), Path(pretrained))
        return stages
    model = _torchvision(name, pretrained)
    _settle(model, frozen=bool(pretrained))
    features = getattr(model, "features", None)
    if isinstance(features, nn.Sequential):
        return list(features)
    children = [child for label, child in model.named_children() if label not in _LAST]
    return [part for child in children for part in (child if isinstance(child, nn.Sequential) else [child])]


def _torchvision(name: str, pretrained: bool | str | Path) -> nn.Module:
    from torchvision import models

    known = models.list_models(module=models)
    if name not in known:
        raise unknown_name("trunk", name, ["tiny", *known], kind=PluginError)
    if pretrained is True:
        try:
            return cast(nn.Module, models.get_model(name, weights="DEFAULT"))
        except (URLError, OSError) as error:
            raise PluginError(
                f"the pretrained weights of '{name}' could not be downloaded ({error})",
                hint="Download them where there is a network and give the file as `pretrained`, or set it to false",
            ) from error
    model = cast(nn.Module, models.get_model(name, weights=None))
    if pretrained:
        load_weights(model, Path(pretrained))
    return model


def load_weights(model: nn.Module, path: Path) -> None:
    """Load a file of tensors; nothing is unpickled.

    Raises:
        PluginError: when the file is missing, damaged or of another architecture.
    """
    if not path.is_file():
        raise PluginError(f"there are no weights at '{path}'", hint="Give the path of a file, or pretrained: false")
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            tensors: dict[str, Any] = load_file(path)
        else:
            tensors = torch.load(path, map_location="cpu", weights_only=True)
        model.load_state_dict(tensors)
    except Exception as error:
        raise PluginError(f"the weights in '{path}' do not load: {str(error).splitlines()[0]}") from error


def _settle(module: nn.Module, frozen: bool) -> None:
    """Take out everything that depends on the batch or on chance, in place."""
    from torchvision.ops import StochasticDepth

    for label, child in module.named_children():
        if isinstance(child, nn.BatchNorm2d):
            setattr(module, label, _frozen(child) if frozen else group_norm(child.num_features))
        elif isinstance(child, nn.Dropout | StochasticDepth):
            setattr(module, label, nn.Identity())
        else:
            _settle(child, frozen)


def _frozen(norm: nn.BatchNorm2d) -> FrozenBatchNorm:
    still = FrozenBatchNorm(norm.num_features, eps=norm.eps)
    still.load_state_dict(norm.state_dict())
    return still.train()


def _levels(name: str, stages: list[nn.Module]) -> list[tuple[int, int]]:
    """(stride, channels) after every stage, found with a picture that holds no memory."""
    found = []
    x = torch.zeros(1, 3, _PROBE, _PROBE, device="meta")
    try:
        for stage in copy.deepcopy(stages):
            x = stage.to("meta")(x)
            if x.ndim != 4 or x.shape[2] != x.shape[3] or _PROBE % x.shape[2]:
                raise ValueError(f"a stage gives the shape {tuple(x.shape)}")
            found.append((_PROBE // x.shape[2], x.shape[1]))
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        raise PluginError(
            f"'{name}' cannot be a trunk: it is not a chain of strided convolution stages",
            allowed="tiny, and torchvision's ResNet, RegNet, EfficientNet, MobileNet, ShuffleNet, ConvNeXt, VGG, ...",
        ) from error
    return found


def _last_of(name: str, levels: list[tuple[int, int]], stride: int | None) -> int:
    """Index of the last stage with the stride."""
    if stride is None:
        return len(levels) - 1
    fitting = [index for index, (level, _) in enumerate(levels) if level == stride]
    if not fitting:
        strides = ", ".join(str(level) for level in sorted({level for level, _ in levels}))
        raise PluginError(f"the trunk '{name}' has no features at stride {stride}", allowed=strides)
    return fitting[-1]
