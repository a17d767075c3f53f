"""Trunks by name: strides, norms that do not depend on the batch, weights from files, errors that help."""

from __future__ import annotations

from pathlib import Path
from urllib.error import URLError

import pytest
import torch
import torchvision
from safetensors.torch import save_file
from torch import nn

from me3bev_cli.errors import PluginError
from me3bev_plugins.spatial.trunks import FrozenBatchNorm, Trunk


@pytest.mark.parametrize(
    ("name", "stride", "channels"),
    [("tiny", 8, 48), ("resnet18", 16, 256), ("mobilenet_v3_small", 16, 48), ("shufflenet_v2_x0_5", 32, 1024)],
)
def test_strides(name: str, stride: int, channels: int) -> None:
    trunk = Trunk(name, stride)
    assert trunk.channels == channels
    assert trunk(torch.randn(1, 3, 64, 96)).shape == (1, channels, 64 // stride, 96 // stride)
    assert not [m for m in trunk.modules() if isinstance(m, nn.BatchNorm2d | nn.Dropout)]


def test_neck_adds_the_coarser_level() -> None:
    trunk = Trunk("mobilenet_v3_small", 16, neck=24)
    x = torch.randn(1, 3, 64, 96)
    assert trunk(x).shape == (1, 24, 4, 6)
    # Height 72 gives odd levels, 5 and 3 rows.
    assert trunk(torch.randn(1, 3, 72, 96)).shape == (1, 24, 5, 6)


def test_weights_from_a_file_keep_their_statistics(tmp_path: Path) -> None:
    """The frozen trunk computes what torchvision's network computes in evaluation mode, and never changes."""
    torch.manual_seed(0)
    model = torchvision.models.resnet18()
    for module in model.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.normal_(0, 0.1)  # type: ignore[union-attr]
            module.running_var.uniform_(0.5, 1.5)  # type: ignore[union-attr]
    save_file(model.state_dict(), tmp_path / "w.safetensors")
    torch.save(model.state_dict(), tmp_path / "w.pt")
    model.eval()
    x = torch.randn(2, 3, 64, 64)
    stem = model.maxpool(model.relu(model.bn1(model.conv1(x))))
    expected = model.layer3(model.layer2(model.layer1(stem)))
    for name in ("w.safetensors", "w.pt"):
        trunk = Trunk("resnet18", 16, str(tmp_path / name)).train()
        torch.testing.assert_close(trunk(x), expected, rtol=1e-4, atol=1e-5)
        assert all(not m.training for m in trunk.modules() if isinstance(m, FrozenBatchNorm))


def test_an_unknown_trunk_is_named_with_the_nearest() -> None:
    with pytest.raises(PluginError, match="unknown trunk 'resnet81'; did you mean 'resnet18'"):
        Trunk("resnet81", 16)


def test_a_network_without_strided_stages_is_refused() -> None:
    with pytest.raises(PluginError, match="'vit_b_16' cannot be a trunk"):
        Trunk("vit_b_16", 16)


def test_a_stride_that_the_trunk_has_not() -> None:
    with pytest.raises(PluginError, match=r"the trunk 'tiny' has no features at stride 32. Allowed: 4, 8, 16"):
        Trunk("tiny", 32)


def test_no_network_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*args: object, **keys: object) -> None:
        raise URLError("no route to host")

    monkeypatch.setattr(torchvision.models._api.WeightsEnum, "get_state_dict", fail)
    with pytest.raises(PluginError, match=r"weights of 'resnet18' could not be downloaded .* give the file"):
        Trunk("resnet18", 16, True)


def test_a_missing_or_foreign_file_of_weights(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="there are no weights at"):
        Trunk("resnet18", 16, str(tmp_path / "none.pt"))
    (tmp_path / "bad.safetensors").write_bytes(b"12345")
    with pytest.raises(PluginError, match=r"bad.safetensors' do not load"):
        Trunk("resnet18", 16, str(tmp_path / "bad.safetensors"))
    torch.save({"x": torch.zeros(1)}, tmp_path / "foreign.pt")
    with pytest.raises(PluginError, match=r"foreign.pt' do not load: Error"):
        Trunk("resnet18", 16, str(tmp_path / "foreign.pt"))
