"""Where trunks come from: ours, torchvision's and timm's, each with published weights, weights of a file, or none."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn

from me3bev_cli.api import need_weights
from me3bev_cli.errors import PluginError, did_you_mean, unknown_name
from me3bev_plugins.spatial.blocks import Residual, conv, group_norm
from me3bev_plugins.spatial.trunk_norms import settle
from me3bev_plugins.spatial.trunk_weights import read_weights

TIMM = "timm:"
"""What a name of timm's begins with: both libraries have a resnet18, and they differ."""

Pretrained = bool | str | Path

_LAST = ("avgpool", "fc", "classifier", "head", "heads", "norm", "aux1", "aux2", "AuxLogits")
_HEADS = ("fc", "classifier", "head", "heads", "aux1", "aux2", "AuxLogits")
_OFFLINE = ("huggingface_hub", "httpx", "requests", "urllib")
"""Packages whose errors mean that a download failed; the others of that kind are OSErrors."""


def tiny_stages(pretrained: Pretrained) -> list[nn.Module]:
    """Three small stages to strides 4, 8 and 16; the first leaps to 4, since it would cost most at 2."""
    if pretrained is True:
        raise PluginError("the trunk 'tiny' has no published weights", hint="Give a file or set pretrained: false")
    stages: list[nn.Module] = [
        nn.Sequential(nn.Conv2d(3, 32, 6, 4, 1, bias=False), group_norm(32), nn.ReLU(inplace=True)),
        nn.Sequential(conv(32, 48, 3, 2), Residual(48, 48)),
        nn.Sequential(Residual(48, 96, 2)),
    ]
    if pretrained and need_weights():
        whole = nn.Sequential(*stages)
        whole.load_state_dict(read_weights(Path(pretrained), whole.state_dict()))
    return stages


def torchvision_stages(name: str, pretrained: Pretrained) -> list[nn.Module]:
    """A torchvision model in the order in which an image passes it, without its classifier."""
    from torchvision import models

    known = models.list_models(module=models)
    if name not in known:
        raise unknown_name("trunk", name, ["tiny", *known], kind=PluginError)
    model = _with_weights(
        name, pretrained, lambda weights: models.get_model(name, weights="DEFAULT" if weights else None)
    )
    if not isinstance(pretrained, bool) and need_weights():
        model.load_state_dict(read_weights(Path(pretrained), model.state_dict(), _HEADS), strict=False)
    settle(model, frozen=bool(pretrained))
    features = getattr(model, "features", None)
    if isinstance(features, nn.Sequential):
        return list(features)
    children = [child for label, child in model.named_children() if label not in _LAST]
    return [part for child in children for part in (child if isinstance(child, nn.Sequential) else [child])]


def timm_features(
    name: str, pretrained: Pretrained, levels: tuple[int, ...] | None
) -> tuple[nn.Module, list[tuple[int, int]]]:
    """A timm model that gives a list of strided features.

    Args:
        name: without the prefix; timm's tags (`resnet18.a1_in1k`) are understood.
        pretrained: as for `Trunk`.
        levels: which of its levels are given, by index; None for all.

    Returns:
        The module, and (stride, channels) of each level.

    Raises:
        PluginError: timm is not installed, or has no such model with strided features, or weights cannot be had.
    """
    timm = _timm()
    if not timm.is_model(name):
        near = did_you_mean(name, timm.list_models())
        raise PluginError(
            f"timm has no model '{name}'" + (f"; {near}" if near else ""), hint="timm.list_models() has all"
        )
    keys: dict[str, Any] = {"features_only": True} | ({} if levels is None else {"out_indices": levels})

    def make(weights: bool) -> nn.Module:
        try:
            return cast(nn.Module, timm.create_model(name, pretrained=weights, **keys))
        except (RuntimeError, AttributeError, TypeError, KeyError, AssertionError) as error:
            if weights:
                raise
            raise PluginError(f"'{TIMM}{name}' cannot be a trunk: timm gives no strided features of it") from error

    model = _shortened(_with_weights(TIMM + name, pretrained, make))
    if not isinstance(pretrained, bool) and need_weights():
        _load_timm(timm, name, model, Path(pretrained))
    settle(model, frozen=bool(pretrained))
    info = cast(Any, model.feature_info)
    return model, list(zip(info.reduction(), info.channels(), strict=True))


def _shortened(model: nn.Module) -> nn.Module:
    """Without the blocks after the last level, which some of timm's networks would compute for nothing."""
    blocks = getattr(model, "blocks", None)
    last = re.match(r"blocks\.(\d+)", cast(Any, model.feature_info).module_name()[-1])
    if isinstance(blocks, nn.Sequential) and last:
        model.blocks = blocks[: int(last[1]) + 1]
    return model


def _timm() -> Any:
    try:
        import timm
    except ImportError as error:
        raise PluginError(
            "trunks whose name begins with 'timm:' need the package timm", hint="pip install 'me3bev[timm]'"
        ) from error
    return timm


def _load_timm(timm: Any, name: str, model: nn.Module, path: Path) -> None:
    """Weights of the whole network into the part that gives features, which has some names joined by `_`."""
    with torch.device("meta"):
        whole = timm.create_model(name)
    head = whole.pretrained_cfg.get("classifier") or ()
    given = read_weights(path, whole.state_dict(), (head,) if isinstance(head, str) else head)
    own = model.state_dict()
    named: dict[str, Tensor] = {
        (key if key in own else key.replace(".", "_", 1)): tensor for key, tensor in given.items()
    }
    wanted = [key for key in own if not key.endswith("num_batches_tracked")]
    lost = [key for key in wanted if key not in named]
    if lost:
        raise PluginError(f"the weights in '{path}' do not fit the features of '{TIMM}{name}': {lost[0]} is missing")
    model.load_state_dict({key: tensor for key, tensor in named.items() if key in own}, strict=False)


def _with_weights(name: str, pretrained: Pretrained, make: Callable[[bool], nn.Module]) -> nn.Module:
    """The model with published weights if they are asked for."""
    if pretrained is not True or not need_weights():
        return make(False)
    try:
        return make(True)
    except Exception as error:
        # A damaged download is a RuntimeError, as is a model without published weights.
        if isinstance(error, OSError | RuntimeError) or type(error).__module__.partition(".")[0] in _OFFLINE:
            raise PluginError(
                f"the pretrained weights of '{name}' could not be downloaded ({error})",
                hint="Download them where there is a network and give the file as `pretrained`, or set it to false",
            ) from error
        raise
