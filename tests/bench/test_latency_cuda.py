"""On a GPU: events, graphs, and networks that decide there what they decide on the CPU."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from me3bev_cli.bench.latency import Effort, measure
from me3bev_cli.bench.latency_device import Graphed
from me3bev_cli.bench.latency_network import STAGES, Bench, Conditions
from me3bev_cli.bench.latency_rows import rows
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.bench.machine_ceilings import Ceilings
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import resolve_recipe

pytestmark = pytest.mark.cuda

CUDA = torch.device("cuda")
TEMPORAL = ("mamba", "gru", "lstm", "transformer")
CONTEXTS = ("{kind: window, length: 4}", "{kind: stream}")


@pytest.fixture(autouse=True)
def _exact() -> None:
    """Products of full precision, as on the CPU."""
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = False


@pytest.mark.parametrize("temporal", TEMPORAL)
@pytest.mark.parametrize("graphs", [True, False])
def test_every_stage_is_timed(line_recipe: Path, temporal: str, graphs: bool) -> None:
    recipe = resolve_recipe(line_recipe, [f"temporal={{name: {temporal}}}"])
    ceilings = Ceilings(CUDA, torch.float32, side=256, read=1 << 24)
    conditions = Conditions(CUDA, graphs=graphs)
    found = rows(measure([Subject("it", recipe)], conditions, Effort(3, 10, 60), [4, 64], ceilings=ceilings))
    assert len(found) == 4
    for row in found:
        assert all(row["stages"][stage] > 0 for stage in STAGES)
        assert 0 < row["median_ms"] <= row["p95_ms"]
        assert row["peak_memory_bytes"] > 4 * row["parameters"]
        assert row["floor_ratio"] > 0


@pytest.mark.parametrize("temporal", TEMPORAL)
def test_graphs_change_no_action(line_recipe: Path, temporal: str) -> None:
    recipe = resolve_recipe(line_recipe, [f"temporal={{name: {temporal}}}"])
    benches = []
    for graphs in (False, True):
        torch.manual_seed(0)
        benches.append(Bench(Subject("it", recipe), Conditions(CUDA, graphs=graphs), [4]))
    assert isinstance(benches[1]._embed, Graphed)
    for _ in range(5):
        for bench in benches:
            bench.turn(bench.variants)
        for mine, other in zip(*(bench.variants for bench in benches), strict=True):
            assert mine.action is not None
            np.testing.assert_allclose(mine.action, other.action, atol=1e-5)


@pytest.mark.parametrize("temporal", TEMPORAL)
@pytest.mark.parametrize("context", CONTEXTS)
def test_a_network_drives_as_on_the_cpu(temporal: str, context: str) -> None:
    recipe = resolve_recipe("quickstart", [f"temporal={{name: {temporal}}}", f"context={context}"])
    drivers = [Controller(build_network(recipe, 0).to(device), recipe) for device in ("cpu", CUDA)]
    generator = np.random.default_rng(0)
    shape = (len(recipe.observation.cameras), 3, recipe.observation.height, recipe.observation.width)
    for _ in range(6):
        frame = {
            "images": generator.integers(0, 256, shape, np.uint8),
            "road": generator.random(9, np.float32),
            "vehicle": generator.random(4, np.float32),
            "navigation": generator.random(5, np.float32),
        }
        here, there = (driver.act(frame) for driver in drivers)
        np.testing.assert_allclose(here, there, atol=1e-4)


@pytest.mark.parametrize("spatial", ["lift_splat", "flat_cnn"])
@pytest.mark.parametrize("temporal", TEMPORAL)
def test_a_network_learns_as_on_the_cpu(spatial: str, temporal: str) -> None:
    """Losses and gradients of a segment with an episode's start inside."""
    trunk = "tiny" if spatial == "lift_splat" else "shufflenet_v2_x1_0"
    choices = [f"spatial.name={spatial}", f"spatial.trunk={trunk}", f"temporal={{name: {temporal}}}"]
    recipe = resolve_recipe("quickstart", choices)
    generator = torch.Generator().manual_seed(0)
    frames, length = 9, 6
    shape = (frames, len(recipe.observation.cameras), 3, recipe.observation.height, recipe.observation.width)
    batch = {
        "images": torch.randint(0, 256, shape, generator=generator, dtype=torch.uint8),
        "road": torch.rand(frames, 9, generator=generator),
        "vehicle": torch.rand(frames, 4, generator=generator),
        "navigation": torch.rand(frames, 5, generator=generator),
    }
    starts = torch.zeros(1, frames, dtype=torch.bool)
    starts[0, 5] = True
    found = []
    for device in ("cpu", CUDA):
        network = build_network(recipe, 0).to(device).eval()
        on_device = {key: value.to(device) for key, value in batch.items()}
        decision = network.evaluate(on_device, network.initial_state(1), starts.to(device))
        loss = decision.actions.mode().square().sum() + decision.values.sum()
        loss.backward()
        grads = {name: p.grad.cpu() for name, p in network.named_parameters() if p.grad is not None}
        found.append((decision.values.detach().cpu(), grads))
    (values, grads), (other_values, other_grads) = found
    assert len(values) == length
    torch.testing.assert_close(values, other_values, atol=1e-4, rtol=1e-3)
    assert grads.keys() == other_grads.keys()
    for name, grad in grads.items():
        largest = float(grad.abs().max())
        torch.testing.assert_close(grad, other_grads[name], atol=1e-4 + 1e-2 * largest, rtol=1e-2, msg=name)


def test_by_command_line(line_recipe: Path) -> None:
    from me3bev_cli.main import app

    options = ["--device", "cuda", "--repeats", "3", "--context", "4", "--dtype", "bf16", "--json", "-"]
    result = CliRunner().invoke(app, ["bench-latency", str(line_recipe), *options], catch_exceptions=False)
    assert result.exit_code == 0
    setup = json.loads(result.stdout)["setup"]
    assert (setup["device"], setup["graphs"]) == (torch.cuda.get_device_name(0), True)
