"""ResNet-18's stages for the decoder: with published weights, weights of a file, or none."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor, nn
from torchvision.models import ResNet18_Weights, resnet18
from torchvision.models.resnet import ResNet

from me3bev_cli.errors import UserError

OPTION = "--pretrained"
_NETWORK = (OSError, RuntimeError)
"""What a download that fails raises; a damaged one is a RuntimeError."""


def resnet_stages(pretrained: bool | str) -> nn.Sequential:
    """The first three stages: (N, 64, X, Y) -> (N, 256, X / 4, Y / 4).

    Args:
        pretrained: True for torchvision's published weights, False for none, or a file of ResNet-18's weights.

    Raises:
        UserError: the weights cannot be downloaded, or the file is missing or is not ResNet-18's.
    """
    if pretrained is True:
        trunk = _published()
    else:
        trunk = resnet18(weights=None)
        if pretrained is not False:
            load_resnet(trunk, Path(pretrained))
    return nn.Sequential(trunk.layer1, trunk.layer2, trunk.layer3)


def parse_pretrained(text: str) -> bool | str:
    """`true`, `false` or the path of a file."""
    return {"true": True, "false": False}.get(text.lower(), text)


def _published() -> ResNet:
    try:
        return resnet18(weights=ResNet18_Weights.DEFAULT)
    except _NETWORK as error:
        raise UserError(
            f"the pretrained weights of ResNet-18 could not be downloaded ({error})",
            where=OPTION,
            hint="Download them where there is a network and give the file, or set it to false",
        ) from error


def load_resnet(trunk: nn.Module, path: Path) -> None:
    """Fill a torchvision ResNet-18 from a file of weights, but for its classifier; only tensors are unpickled.

    Raises:
        UserError: the file is missing, damaged or of another network.
    """
    if not path.is_file():
        raise UserError(f"there are no weights at '{path}'", where=OPTION, allowed="true, false, or the path of a file")
    given = _tensors(path)
    own = {key: value for key, value in trunk.state_dict().items() if not key.startswith("fc.")}
    wrong = [
        key
        for key, value in own.items()
        if not key.endswith("num_batches_tracked") and (key not in given or given[key].shape != value.shape)
    ]
    if wrong:
        raise UserError(
            f"'{path}' does not hold ResNet-18 weights: {len(wrong)} parameters differ, first '{wrong[0]}'",
            where=OPTION,
            hint="Save the state dict of torchvision's resnet18 there",
        )
    trunk.load_state_dict({key: given[key] for key in own if key in given}, strict=False)


def _tensors(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(path)
        found = torch.load(path, map_location="cpu", weights_only=True)
        if isinstance(found, dict) and all(isinstance(value, Tensor) for value in found.values()):
            return found
        reason = "it is no table of tensors"
    except Exception as error:  # torch.load raises many types for a file that is not its own
        reason = type(error).__name__
    raise UserError(
        f"'{path}' does not hold ResNet-18 weights ({reason})",
        where=OPTION,
        allowed="a .safetensors file, or a state dict written by torch.save",
    )
