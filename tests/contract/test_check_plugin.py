"""Every installed plugin keeps its contract, and a plugin that breaks one promise is told which."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from me3bev_cli.api import GROUPS, NoConfig, PluginConfig
from me3bev_cli.errors import PluginError, UserError
from me3bev_cli.testing import check_plugin, small_rig

SMALL: dict[str, dict[str, Any]] = {
    "lift_splat": {
        "trunk": "tiny",
        "stride": 8,
        "neck": 12,
        "cell": 2.0,
        "channels": 6,
        "bev_channels": (8, 8, 12),
        "token_rows": 4,
        "token_columns": 4,
        "token_width": 8,
    },
    "flat_cnn": {"trunk": "tiny", "width": 16},
    "transformer": {"layers": 2, "context": 5},
    "gru": {"layers": 2},
    "lstm": {"hidden": 20},
}
INSTALLED = [
    pytest.param(kind, entry, id=f"{kind}-{entry.name}")
    for kind, group in GROUPS.items()
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name)
    if entry.value.startswith("me3bev_plugins.")
]


@pytest.mark.parametrize(("kind", "entry"), INSTALLED)
def test_installed_plugins_keep_their_contract(kind: str, entry: EntryPoint) -> None:
    check_plugin(kind, entry.load(), SMALL.get(entry.name))


@pytest.mark.parametrize("trunk", ["shufflenet_v2_x0_5", "mobilenet_v3_small"])
def test_torchvision_trunks_keep_the_contract(trunk: str) -> None:
    check_plugin("spatial", entry_points(group="me3bev.spatial")["flat_cnn"].load(), {"trunk": trunk, "width": 8})


@pytest.mark.parametrize("name", ["lift_splat", "flat_cnn"])
@pytest.mark.parametrize(
    ("keys", "cameras"), [({"precision": "bf16"}, 6), ({"channels_last": False}, 6), ({}, 1), ({}, 8)]
)
def test_spatial_plugins_keep_it_however_they_compute(name: str, keys: dict[str, Any], cameras: int) -> None:
    cls = entry_points(group="me3bev.spatial")[name].load()
    check_plugin("spatial", cls, SMALL[name] | keys, rig=small_rig(cameras=cameras))


class ByOrder(nn.Module):
    """Takes the modalities as they come."""

    Config = NoConfig

    def __init__(self, config: PluginConfig, widths: Mapping[str, int]) -> None:
        super().__init__()
        self.linear = nn.Linear(sum(widths.values()), 6)

    @classmethod
    def output_width(cls, config: PluginConfig, widths: Mapping[str, int]) -> int:
        return 6

    def forward(self, features: Mapping[str, Tensor]) -> Tensor:
        result: Tensor = self.linear(torch.cat(list(features.values()), -1))
        return result


class TooWide(ByOrder):
    @classmethod
    def output_width(cls, config: PluginConfig, widths: Mapping[str, int]) -> int:
        return 7


@pytest.mark.parametrize(
    ("cls", "promise"), [(ByOrder, "modalities are taken by name"), (TooWide, "the result's shape is (5, 7)")]
)
def test_a_broken_fusion_is_told_what_it_breaks(cls: type, promise: str) -> None:
    with pytest.raises(PluginError) as caught:
        check_plugin("fusion", cls)
    assert promise in str(caught.value)


def test_an_unknown_kind() -> None:
    with pytest.raises(UserError, match="unknown kind of plugin 'temporl'; did you mean 'temporal'"):
        check_plugin("temporl", ByOrder)
