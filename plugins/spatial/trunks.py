"""Image trunks by name: ours (`tiny`), torchvision's chains of strided stages, or timm's strided features.

No trunk keeps batch statistics or chance: see `trunk_norms`.
"""

from __future__ import annotations

import copy
from functools import cache
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from me3bev_cli.errors import PluginError
from me3bev_plugins.spatial.blocks import conv, group_norm
from me3bev_plugins.spatial.trunk_sources import TIMM, Pretrained, timm_features, tiny_stages, torchvision_stages

_PROBE = (128, 160)
"""(H, W) of the picture by which strides are found."""

Levels = list[tuple[int, int]]
"""(stride, channels) of a network's features, in the order in which an image passes it."""


class Trunk(nn.Module):
    """The stages of an image network up to a stride.

    Args:
        name: `tiny`, a torchvision model, or `timm:` and a model of timm.
        stride: image pixels per feature cell, a power of two; None for the whole network.
        pretrained: true for published weights, or a file of weights (.safetensors or a torch file of tensors).
        neck: width of a pyramid neck that adds the next coarser level, upsampled; None for no neck.

    Raises:
        PluginError: for an unknown or unsuitable trunk, or weights that cannot be had.
    """

    def __init__(
        self, name: str, stride: int | None = None, pretrained: Pretrained = False, neck: int | None = None
    ) -> None:
        super().__init__()
        make = _timm if name.startswith(TIMM) else _chain
        self.stages, self.coarse, channels = make(name, stride, pretrained, neck is not None)
        self.channels = channels[0]
        self.neck = neck is not None
        if neck is not None:
            self.fine_in = nn.Conv2d(channels[0], neck, 1)
            self.coarse_in = nn.Conv2d(channels[1], neck, 1, bias=False)
            self.merge = nn.Sequential(group_norm(neck), nn.ReLU(), *conv(neck, neck))
            self.channels = neck

    def forward(self, images: Tensor) -> Tensor:
        """Images (M, 3, H, W) -> features (M, channels, h, w)."""
        fine = self.stages(images)
        if isinstance(fine, list):
            fine, above = fine if self.neck else (fine[0], None)
        else:
            above = None if self.coarse is None else self.coarse(fine)
        if above is None:
            return cast(Tensor, fine)
        above = cast(Tensor, self.coarse_in(above))
        above = F.interpolate(above, size=fine.shape[-2:], mode="bilinear", align_corners=False)
        return cast(Tensor, self.merge(cast(Tensor, self.fine_in(fine)) + above))


Made = tuple[nn.Module, nn.Module | None, list[int]]
"""What gives the fine features (timm's gives all, in a list), what makes coarse ones of them, and their channels."""


def _chain(name: str, stride: int | None, pretrained: Pretrained, coarser: bool) -> Made:
    """Stages one after another: features at the stride and, if asked for, at the next coarser one."""
    stages = tiny_stages(pretrained) if name == "tiny" else torchvision_stages(name, pretrained)
    levels = _levels_of(name, stages)
    last = _last_of(name, levels, stride)
    fine = nn.Sequential(*stages[: last + 1])
    if not coarser:
        return fine, None, [levels[last][1]]
    end = _last_of(name, levels, 2 * levels[last][0])
    return fine, nn.Sequential(*stages[last + 1 : end + 1]), [levels[last][1], levels[end][1]]


def _timm(name: str, stride: int | None, pretrained: Pretrained, coarser: bool) -> Made:
    """timm's features at the stride and, if asked for, at the next coarser one."""
    short = name.removeprefix(TIMM)
    with torch.device("meta"):
        _, levels = timm_features(short, False, None)
    wanted = [_last_of(name, levels, stride)]
    if coarser:
        wanted.append(_last_of(name, levels, 2 * levels[wanted[0]][0]))
    features, _ = timm_features(short, pretrained, tuple(wanted))
    _settle_pyramid(name, features, [levels[index] for index in wanted])
    return features, None, [levels[index][1] for index in wanted]


@cache
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


def _levels_of(name: str, stages: list[nn.Module]) -> Levels:
    """(stride, channels) after every stage, found with a picture that holds no memory."""
    found = []
    x = torch.zeros(1, 3, *_PROBE, device="meta")
    try:
        for stage in copy.deepcopy(stages):
            x = stage.to("meta")(x)
            found.append((_stride_of(x), x.shape[1]))
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        raise PluginError(
            f"'{name}' cannot be a trunk: it is not a chain of strided convolution stages",
            allowed="tiny, and torchvision's ResNet, RegNet, EfficientNet, MobileNet, ShuffleNet, ConvNeXt, VGG, ...",
        ) from error
    return found


def _settle_pyramid(name: str, features: nn.Module, expected: Levels) -> None:
    """Refuse networks that take one size of image only; fix the parameters that do not reach the features."""
    try:
        probe = copy.deepcopy(features).to("meta")
        with torch.enable_grad():
            given = probe(torch.zeros(1, 3, *_PROBE, device="meta"))
            found = [(_stride_of(level), level.shape[1]) for level in given]
            total = torch.stack([level.sum() for level in given]).sum()
            reached = torch.autograd.grad(total, list(probe.parameters()), allow_unused=True)
    except (RuntimeError, ValueError, TypeError, AssertionError) as error:
        raise PluginError(
            f"'{name}' cannot be a trunk: {(str(error).splitlines() or [type(error).__name__])[0]}",
            allowed="timm's convolutional networks",
        ) from error
    if found != expected:
        raise PluginError(f"'{name}' cannot be a trunk: its features are {found}, not {expected} (stride, channels)")
    for parameter, grad in zip(features.parameters(), reached, strict=True):
        parameter.requires_grad_(grad is not None)


def _stride_of(x: Tensor) -> int:
    if x.ndim != 4 or _PROBE[0] % x.shape[2] or _PROBE[0] * x.shape[3] != _PROBE[1] * x.shape[2]:
        raise ValueError(f"a stage gives the shape {tuple(x.shape)}")
    return _PROBE[0] // x.shape[2]


def _last_of(name: str, levels: Levels, stride: int | None) -> int:
    """Index of the last level with the stride."""
    if stride is None:
        return len(levels) - 1
    fitting = [index for index, (level, _) in enumerate(levels) if level == stride]
    if not fitting:
        strides = ", ".join(str(level) for level in sorted({level for level, _ in levels}))
        raise PluginError(f"the trunk '{name}' has no features at stride {stride}", allowed=strides)
    return fitting[-1]
