"""The two fusions on numbers worked by hand."""

from __future__ import annotations

import pytest
import torch

from me3bev_cli.api import NoConfig
from me3bev_plugins.fusion.concat import Concat
from me3bev_plugins.fusion.sum import Sum

FEATURES = {
    "bev": torch.tensor([[1.0, 2.0]]),
    "vr": torch.tensor([[10.0, 20.0]]),
    "nav": torch.tensor([[100.0, 200.0]]),
}


def test_sum_adds() -> None:
    fusion = Sum(NoConfig(), {"bev": 2, "vr": 2, "nav": 2})
    assert fusion(FEATURES).tolist() == [[111.0, 222.0]]


def test_sum_refuses_unequal_widths() -> None:
    with pytest.raises(ValueError, match="adding needs equal widths, but they are bev 4, vr 2"):
        Sum.output_width(NoConfig(), {"bev": 4, "vr": 2})


def test_concat_joins_in_the_order_of_the_widths() -> None:
    fusion = Concat(Concat.Config(width=2, activation="relu"), {"bev": 2, "vr": 2, "nav": 2})
    with torch.no_grad():
        fusion.linear.weight.copy_(torch.tensor([[1.0, 0, 0, 2, 0, 0], [0, 0, 0, 0, -1, 0]]))
        fusion.linear.bias.copy_(torch.tensor([0.5, 3.0]))
    # 1 + 2 * 20 + 0.5, and -100 + 3 cut off at 0.
    assert fusion(FEATURES).tolist() == [[41.5, 0.0]]


@pytest.mark.parametrize("cls", [Sum, Concat])
def test_no_modality_is_refused(cls: type[Sum] | type[Concat]) -> None:
    with pytest.raises(ValueError, match="no modality is given"):
        cls.output_width(cls.Config(), {})  # type: ignore[arg-type]
