"""bf16 and the order in memory: what they change and what they must not."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch
from torch import nn

from me3bev_cli.bench.precision import bf16_error, relative_error
from me3bev_plugins.spatial import precision
from me3bev_plugins.spatial.flat_cnn import FlatCNN
from me3bev_plugins.spatial.lift_splat import LiftSplat

SMALL: dict[str, Any] = {
    "trunk": "mobilenet_v3_small", "stride": 16, "neck": 16, "depth_bins": 9, "channels": 8, "cell": 2.0,
    "bev_channels": (8, 12, 16), "token_width": 8,
}  # fmt: skip
KINDS = [
    pytest.param(LiftSplat, SMALL, id="lift_splat"),
    pytest.param(FlatCNN, {"trunk": "shufflenet_v2_x0_5", "width": 16}, id="flat_cnn"),
]


def make(cls: Any, keys: dict[str, Any]) -> nn.Module:
    torch.manual_seed(0)
    module: nn.Module = cls(cls.Config(**keys), naive.rig(height=64, width=96))
    return module


@pytest.mark.parametrize(("cls", "keys"), KINDS)
def test_bf16_is_near_fp32(cls: Any, keys: dict[str, Any]) -> None:
    """Eight bits of mantissa through some twenty layers: a few per cent; every output in the images' type."""
    torch.manual_seed(1)
    images = torch.randn(2, 6, 3, 64, 96)
    errors = bf16_error(cls, cls.Config(**keys), naive.rig(height=64, width=96), images)
    assert set(errors) == ({"tokens", "grid", "depth_logits"} if cls is LiftSplat else {"tokens"})
    assert all(1e-5 < error < 0.05 for error in errors.values()), errors
    output = make(cls, keys | {"precision": "bf16"})(images)
    assert {part.dtype for part in output if part is not None} == {torch.float32}


@pytest.mark.parametrize(("cls", "keys"), KINDS)
def test_gradients_in_bf16(cls: Any, keys: dict[str, Any]) -> None:
    """The parameters and their gradients stay float32, and point where those of fp32 point."""
    torch.manual_seed(1)
    images = torch.randn(2, 6, 3, 64, 96)
    grads = []
    for name in ("fp32", "bf16"):
        module = make(cls, keys | {"precision": name})
        torch.stack([part.square().mean() for part in module(images) if part is not None]).sum().backward()
        assert all(p.dtype == torch.float32 and p.grad is not None for p in module.parameters())
        grads.append(torch.cat([p.grad.flatten() for p in module.parameters() if p.grad is not None]))
    assert torch.cosine_similarity(*grads, dim=0) > 0.9


@pytest.mark.parametrize(("cls", "keys"), KINDS)
def test_the_order_in_memory_changes_nothing(cls: Any, keys: dict[str, Any]) -> None:
    images = torch.randn(2, 6, 3, 64, 96)
    first, second = (make(cls, keys | {"channels_last": choice})(images) for choice in (True, False))
    torch.testing.assert_close(second.tokens, first.tokens, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(make(cls, keys)(images).tokens, first.tokens)


@pytest.mark.parametrize(("cls", "keys"), KINDS)
def test_weights_are_in_the_order_of_the_images(cls: Any, keys: dict[str, Any]) -> None:
    """And go to a file and back as ever."""
    module = make(cls, keys)
    kernels = [p for p in module.parameters() if p.ndim == 4 and p.shape[1] > 1 and p.shape[-1] > 1]
    assert kernels
    assert all(p.is_contiguous(memory_format=torch.channels_last) and not p.is_contiguous() for p in kernels)
    plain = make(cls, keys | {"channels_last": False})
    assert all(p.is_contiguous() for p in plain.parameters())
    plain.load_state_dict({name: value.contiguous() for name, value in module.state_dict().items()})
    images = torch.randn(1, 6, 3, 64, 96)
    torch.testing.assert_close(plain(images).tokens, module(images).tokens, rtol=1e-4, atol=1e-5)


def test_the_plain_order_is_kept_where_it_is_asked_for() -> None:
    images = torch.randn(2, 3, 8, 8)
    assert precision.laid_out(images, False).is_contiguous()
    for choice in (True, "auto"):
        assert precision.laid_out(images, choice).is_contiguous(memory_format=torch.channels_last)


@pytest.mark.parametrize("native", [True, False])
def test_auto_goes_by_the_hardware(native: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precision, "multiplies_bf16", lambda device: native)
    with precision.computing("auto", torch.device("cpu")):
        assert torch.is_autocast_enabled("cpu") == native
    with precision.computing("bf16", torch.device("cpu")):
        assert torch.is_autocast_enabled("cpu")
    with precision.computing("fp32", torch.device("cpu")):
        assert not torch.is_autocast_enabled("cpu")


def test_whether_a_cpu_multiplies_bf16(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("_is_avx512_bf16_supported", "_is_amx_tile_supported")
    for name in names:
        monkeypatch.setattr(torch.cpu, name, lambda: False, raising=False)
    assert not precision.multiplies_bf16(torch.device("cpu"))
    monkeypatch.setattr(torch.cpu, names[1], lambda: True)
    assert precision.multiplies_bf16(torch.device("cpu"))
    assert not precision.multiplies_bf16(torch.device("meta"))


def test_the_splat_stays_wide_under_a_callers_autocast() -> None:
    module = make(LiftSplat, SMALL)
    probability = torch.rand(1, 6, 9, 4, 6)
    context = torch.randn(1, 6, 8, 4, 6)
    with torch.autocast("cpu", torch.bfloat16):
        cells = module.pool(probability, context.bfloat16())  # type: ignore[operator]
    assert cells.dtype == torch.float32
    torch.testing.assert_close(cells, module.pool(probability, context.bfloat16().float()))  # type: ignore[operator]


def test_relative_error_by_hand() -> None:
    """(3, 4) off by (0, 0.5): 0.5 of 5."""
    assert relative_error(torch.tensor([3.0, 4.5]), torch.tensor([3.0, 4.0])) == pytest.approx(0.1)
