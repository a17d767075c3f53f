"""How far a spatial plugin's outputs in bf16 are from those in fp32."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any

import torch
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig, Rig, weights_follow


def bf16_error(
    cls: type[Any],
    config: PluginConfig,
    rig: Rig,
    images: Tensor,
    state: Mapping[str, Tensor] | None = None,
    seed: int = 0,
) -> dict[str, float]:
    """The norm of the difference over the norm of the fp32 output, for each output.

    Both modules have the same weights and differ in their `precision`; a plugin without that key is run under
    autocast instead.

    Args:
        cls: a spatial plugin's class.
        config: of that class.
        rig: the cameras that `images` come from.
        images: (N, C, 3, H, W), ImageNet-normalised; their device is where both are computed.
        state: weights, as the plugin's `state_dict`; None for those drawn from `seed`.
        seed: of the weights where none are given.
    """
    own = "precision" in type(config).model_fields
    exact, half = (
        _made(cls, config.model_copy(update={"precision": precision}) if own else config, rig, state, seed)
        for precision in ("fp32", "bf16")
    )
    device = images.device.type
    with torch.no_grad():
        right = exact.to(images.device)(images)
        with torch.autocast(device, torch.bfloat16, enabled=not own):
            given = half.to(images.device)(images)
    pairs = {name: (getattr(given, name), value) for name, value in right._asdict().items() if value is not None}
    return {name: relative_error(mine, value) for name, (mine, value) in pairs.items()}


def relative_error(value: Tensor, right: Tensor) -> float:
    """The norm of the difference over the norm of what is right."""
    gap = (value.double() - right.double()).norm()
    return float(gap / right.double().norm().clamp(min=torch.finfo(torch.float64).tiny))


def _made(cls: type[Any], config: PluginConfig, rig: Rig, state: Mapping[str, Tensor] | None, seed: int) -> nn.Module:
    follow = weights_follow() if state is not None else nullcontext()
    with torch.random.fork_rng(devices=[]), follow:
        torch.manual_seed(seed)
        module: nn.Module = cls(config, rig)
    if state is not None:
        module.load_state_dict(state)
    return module.eval()
