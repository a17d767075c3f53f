"""On a GPU: the same numbers as on the CPU, in the same place, for fixed and jittered calibration."""

from __future__ import annotations

from typing import Any

import naive_lift_splat as naive
import pytest
import torch

from me3bev_cli.api import Calibration
from me3bev_cli.testing_spatial import jittered, rig_calibration
from me3bev_plugins.spatial.flat_cnn import FlatCNN
from me3bev_plugins.spatial.lift_splat import LiftSplat

pytestmark = pytest.mark.cuda

KINDS: list[tuple[Any, dict[str, Any]]] = [
    (LiftSplat, {"trunk": "tiny", "stride": 8, "neck": 8, "cell": 2.0, "channels": 8, "bev_channels": (8, 8, 12)}),
    (FlatCNN, {"trunk": "shufflenet_v2_x0_5", "width": 16}),
]


@pytest.mark.parametrize(("cls", "keys"), KINDS)
@pytest.mark.parametrize("per_frame", [False, True])
def test_the_gpu_gives_what_the_cpu_gives(cls: Any, keys: dict[str, Any], per_frame: bool) -> None:
    """In float64, so that neither the order of sums nor shorter products matter; gradients too."""
    rig = naive.rig(height=64, width=96)
    torch.manual_seed(0)
    module = cls(cls.Config(**keys), rig).double()
    images = torch.randn(2, 6, 3, 64, 96, dtype=torch.float64)
    calibration = jittered(rig_calibration(rig, 2), 0)
    found = []
    for device in ("cpu", "cuda"):
        module.to(device)
        given = [Calibration(*(part.to(device) for part in calibration))] if per_frame else []
        output = [part for part in module(images.to(device), *given) if part is not None]
        grads = torch.autograd.grad(sum(part.sin().sum() for part in output), list(module.parameters()))
        assert {part.device.type for part in output} == {device}
        found.append([part.cpu() for part in (*output, *grads)])
    for mine, theirs in zip(*found, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("cls", "keys"), KINDS)
def test_the_same_twice_on_the_gpu(cls: Any, keys: dict[str, Any]) -> None:
    """No atomic sums in the splat: forward passes do not differ by a bit."""
    module = cls(cls.Config(**keys), naive.rig(height=64, width=96)).cuda()
    images = torch.randn(2, 6, 3, 64, 96, device="cuda")
    with torch.no_grad():
        assert torch.equal(module(images).tokens, module(images).tokens)
