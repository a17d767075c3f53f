"""The decoder and its ResNet."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torchvision.models import resnet18

from me3bev_cli.decoding import resnet
from me3bev_cli.decoding.decoder import LatentSpec, SemanticDecoder
from me3bev_cli.decoding.resnet import parse_pretrained, resnet_stages
from me3bev_cli.errors import UserError


@pytest.mark.parametrize("spec", [(16, 1, 1), (8, 2, 2), (6, 12, 12), (4, 20, 20), (4, 100, 100), (4, 10, 20)])
def test_any_latent_becomes_a_map_of_scores(spec: tuple[int, int, int]) -> None:
    decoder = SemanticDecoder(LatentSpec(*spec)).eval()
    with torch.inference_mode():
        assert decoder(torch.zeros(1, *spec)).shape == (1, 8, 200, 200)


def test_weights_of_a_file_are_loaded(tmp_path: Path) -> None:
    torch.manual_seed(7)
    source = resnet18(weights=None)
    torch.save(source.state_dict(), tmp_path / "r.pt")
    stages = resnet_stages(str(tmp_path / "r.pt"))
    assert torch.equal(stages[2][1].conv2.weight, source.layer3[1].conv2.weight)


@pytest.mark.parametrize("content", [b"nothing", None])
def test_a_file_that_is_not_resnets_is_refused(tmp_path: Path, content: bytes | None) -> None:
    bad = tmp_path / "weights.pt"
    if content is None:
        torch.save({"layer1.0.conv1.weight": torch.zeros(3)}, bad)
    else:
        bad.write_bytes(content)
    with pytest.raises(UserError, match=r"--pretrained: .* does not hold ResNet-18 weights"):
        resnet_stages(str(bad))


def test_a_missing_file_is_told() -> None:
    with pytest.raises(UserError, match=r"there are no weights at 'no/where\.pt'"):
        resnet_stages("no/where.pt")


def test_published_weights_without_a_network_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*_: object, **__: object) -> None:
        raise OSError("no route to host")

    monkeypatch.setattr(resnet, "resnet18", offline)
    with pytest.raises(UserError, match=r"could not be downloaded \(no route to host\).*give the file"):
        resnet_stages(True)


def test_pretrained_is_a_word_or_a_path() -> None:
    assert [parse_pretrained(text) for text in ("true", "False", "a/b.pt")] == [True, False, "a/b.pt"]
