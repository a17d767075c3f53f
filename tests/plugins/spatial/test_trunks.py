"""Trunks by name: strides, norms that do not depend on the batch, weights from files, errors that help."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from urllib.error import URLError

import pytest
import torch
import torchvision
from safetensors.torch import save_file
from torch import nn

from me3bev_cli.api import weights_follow
from me3bev_cli.errors import PluginError
from me3bev_plugins.spatial.trunk_norms import FrozenBatchNorm
from me3bev_plugins.spatial.trunks import Trunk


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
    with pytest.raises(PluginError, match=r"bad.safetensors' cannot be read"):
        Trunk("resnet18", 16, str(tmp_path / "bad.safetensors"))
    torch.save({"x": torch.zeros(1)}, tmp_path / "foreign.pt")
    with pytest.raises(
        PluginError, match=r"foreign.pt' are of another network: missing: conv1.weight, .* unexpected: x"
    ):
        Trunk("resnet18", 16, str(tmp_path / "foreign.pt"))


class Harm:
    """Would run when unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return Path.touch, (Path("harm"),)


def test_a_pickle_is_never_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"conv1.weight": Harm()}, tmp_path / "harm.pth")
    with pytest.raises(PluginError, match=r"harm.pth' cannot be read"):
        Trunk("resnet18", 16, str(tmp_path / "harm.pth"))
    assert not (tmp_path / "harm").exists()


def test_differences_are_named(tmp_path: Path) -> None:
    """A deeper network's file has the same names and more; a wider one's has other shapes."""
    torch.save(torchvision.models.resnet34().state_dict(), tmp_path / "deep.pth")
    with pytest.raises(PluginError, match=r"unexpected: layer1.2.conv1.weight, .* and \d+ more\. Name the trunk"):
        Trunk("resnet18", 16, str(tmp_path / "deep.pth"))
    state = torchvision.models.resnet18().state_dict()
    state["conv1.weight"] = torch.zeros(64, 3, 3, 3)
    torch.save(state, tmp_path / "other.pth")
    with pytest.raises(PluginError, match=r"of another shape: conv1\.weight 64 x 3 x 3 x 3 for 64 x 3 x 7 x 7"):
        Trunk("resnet18", 16, str(tmp_path / "other.pth"))
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(PluginError, match="are not a table of tensors"):
        Trunk("resnet18", 16, str(tmp_path / "list.pth"))


def test_files_of_training_scripts(tmp_path: Path) -> None:
    """Wrapped in `state_dict`, with the prefix of several devices, and with a head for other classes."""
    torch.manual_seed(0)
    model = torchvision.models.shufflenet_v2_x0_5(num_classes=3)
    wrapped = {"epoch": 3, "state_dict": {f"module.{name}": value for name, value in model.state_dict().items()}}
    torch.save(wrapped, tmp_path / "w.pth")
    trunk = Trunk("shufflenet_v2_x0_5", None, str(tmp_path / "w.pth"))
    assert torch.equal(trunk.stages[0].weight, model.conv1[0].weight)


def test_tiny_from_a_file(tmp_path: Path) -> None:
    torch.manual_seed(0)
    whole = Trunk("tiny")
    torch.save(whole.stages.state_dict(), tmp_path / "t.pth")
    x = torch.randn(1, 3, 32, 48)
    torch.testing.assert_close(Trunk("tiny", None, str(tmp_path / "t.pth"))(x), whole(x))
    with pytest.raises(PluginError, match="'tiny' has no published weights"):
        Trunk("tiny", None, True)


@pytest.mark.parametrize(
    "name",
    ["efficientnet_b0", "mobilenet_v3_small", "resnet18", "resnet34", "resnet50", "shufflenet_v2_x1_0"],
)
def test_every_named_trunk_trains_at_stride_16_with_a_neck(name: str) -> None:
    """Height and width are not those of a probe; every parameter learns."""
    trunk = Trunk(name, 16, neck=8)
    features = trunk(torch.randn(1, 3, 48, 80))
    assert features.shape == (1, 8, 3, 5)
    features.square().sum().backward()
    assert [label for label, p in trunk.named_parameters() if p.grad is None] == []


class TestTimm:
    """Needs the extra `timm`."""

    @pytest.fixture(autouse=True)
    def timm(self) -> object:
        return pytest.importorskip("timm")

    @pytest.mark.parametrize(
        ("name", "channels"), [("resnet18", 256), ("mobilenetv3_small_050", 24), ("efficientnet_b0", 112)]
    )
    def test_strided_features(self, name: str, channels: int) -> None:
        for neck in (None, 8):
            trunk = Trunk(f"timm:{name}", 16, neck=neck)
            features = trunk(torch.randn(1, 3, 48, 80))
            assert features.shape == (1, neck or channels, 3, 5)
            features.square().sum().backward()
            assert [label for label, p in trunk.named_parameters() if p.requires_grad and p.grad is None] == []
            assert not [m for m in trunk.modules() if isinstance(m, nn.BatchNorm2d | nn.Dropout)]

    @pytest.mark.parametrize("name", ["resnet18", "mobilenetv3_small_050", "regnety_002"])
    def test_weights_of_a_file_with_frozen_statistics(self, timm: Any, name: str, tmp_path: Path) -> None:
        """A file of the whole network gives what timm's own features give in evaluation mode."""
        torch.manual_seed(0)
        whole = timm.create_model(name)
        for module in whole.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.running_mean.normal_(0, 0.1)
                module.running_var.uniform_(0.5, 1.5)
        save_file(whole.state_dict(), tmp_path / "w.safetensors")
        features = timm.create_model(name, features_only=True, out_indices=(3,)).eval()
        own = features.state_dict()
        given = {key if key in own else key.replace(".", "_", 1): value for key, value in whole.state_dict().items()}
        features.load_state_dict({key: value for key, value in given.items() if key in own})
        trunk = Trunk(f"timm:{name}", 16, str(tmp_path / "w.safetensors")).train()
        x = torch.randn(2, 3, 64, 64)
        torch.testing.assert_close(trunk(x), features(x)[0], rtol=1e-4, atol=1e-5)
        with pytest.raises(PluginError, match=r"are of another network: missing: "):
            Trunk("timm:resnet26", 16, str(tmp_path / "w.safetensors"))

    def test_names_and_strides_that_do_not_fit(self) -> None:
        with pytest.raises(PluginError, match="timm has no model 'resnt18'; did you mean 'resnet18'"):
            Trunk("timm:resnt18", 16)
        with pytest.raises(
            PluginError, match=r"'timm:resnet18' has no features at stride 64. Allowed: 2, 4, 8, 16, 32"
        ):
            Trunk("timm:resnet18", 64)
        with pytest.raises(PluginError, match="'timm:vit_tiny_patch16_224' cannot be a trunk"):
            Trunk("timm:vit_tiny_patch16_224", 16)

    def test_no_network(self, timm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        real = timm.create_model

        def offline(name: str, pretrained: bool = False, **keys: Any) -> nn.Module:
            if pretrained:
                raise URLError("no route to host")
            model: nn.Module = real(name, **keys)
            return model

        monkeypatch.setattr(timm, "create_model", offline)
        with pytest.raises(PluginError, match=r"weights of 'timm:resnet18' could not be downloaded .* give the file"):
            Trunk("timm:resnet18", 16, True)


def test_without_timm_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(PluginError, match=r"need the package timm\. pip install 'me3bev\[timm\]'"):
        Trunk("timm:resnet18", 16)


def test_a_checkpoint_needs_no_pretrained_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file may be gone and the machine offline: what is built has the same names, and the statistics come along."""

    def fail(*args: object, **keys: object) -> None:
        raise URLError("no route to host")

    monkeypatch.setattr(torchvision.models._api.WeightsEnum, "get_state_dict", fail)
    torch.save(torchvision.models.resnet18().state_dict(), tmp_path / "w.pth")
    given = Trunk("resnet18", 16, str(tmp_path / "w.pth"))
    for pretrained in (True, str(tmp_path / "gone.pth")):
        with pytest.raises(PluginError):
            Trunk("resnet18", 16, pretrained)
        with weights_follow():
            bare = Trunk("resnet18", 16, pretrained)
        bare.load_state_dict(given.state_dict())
        x = torch.randn(1, 3, 64, 64)
        torch.testing.assert_close(bare(x), given(x))
