"""How a network is computed: the order of its tensors in memory and the width of its numbers.

Neither changes the parameters, which stay float32. `python -m me3bev_cli.bench.spatial` measures what each gains here
and how far bf16 is from fp32.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig

Precision = Literal["fp32", "bf16", "auto"]


class ComputeConfig(PluginConfig):
    """Keys of every spatial plugin whose work is convolutions."""

    channels_last: bool | Literal["auto"] = Field(
        default="auto", description="keep channels innermost; auto: on CPUs and CUDA, where convolutions gain from it"
    )
    precision: Precision = Field(
        default="fp32",
        description="of convolutions: fp32, bf16 (autocast), or auto: bf16 where the hardware multiplies it natively",
    )


def laid_out(images: Tensor, channels_last: bool | str) -> Tensor:
    """Images (M, 3, H, W) in the memory order that the configuration asks for; the layers after them keep it."""
    chosen = images.device.type in ("cpu", "cuda", "meta") if channels_last == "auto" else channels_last
    return images.contiguous(memory_format=torch.channels_last if chosen else torch.contiguous_format)


def arrange(module: nn.Module, channels_last: bool | str) -> None:
    """Keep the convolutions' weights in the order of the images, in place: torch would reorder them at every call."""
    if channels_last:
        module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def computing(precision: Precision, device: torch.device) -> AbstractContextManager[None]:
    """The context in which convolutions run; `fp32` leaves a caller's own autocast alone."""
    if precision == "fp32" or (precision == "auto" and not multiplies_bf16(device)):
        return nullcontext()
    return torch.autocast(device.type, torch.bfloat16)


def unhalved(device: torch.device) -> AbstractContextManager[None]:
    """The context in which a caller's autocast is off; some devices know no autocast."""
    known = torch.amp.is_autocast_available(device.type)
    return torch.autocast(device.type, enabled=False) if known else nullcontext()


def multiplies_bf16(device: torch.device) -> bool:
    """Whether the device is known to have instructions for bf16 products; without them bf16 is slower than fp32."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if device.type == "cpu":
        tests = (getattr(torch.cpu, name, None) for name in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"))
        return any(test() for test in tests if test is not None)
    return False
