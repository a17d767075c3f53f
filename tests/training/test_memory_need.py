"""Memory is counted before it is taken; what cannot fit is refused with the numbers."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from me3bev_cli.errors import MemoryShortError
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.network import Network
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.recipe_stages import ImitationStage, PerceptionStage
from me3bev_cli.stopping import Stop
from me3bev_cli.training import trainer
from me3bev_cli.training.display import Display
from me3bev_cli.training.memory_limits import available_memory, available_on
from me3bev_cli.training.memory_need import GRADIENTS, check_memory, measure_kept, stage_need

CPU = torch.device("cpu")
IMAGES, VECTORS, STEP = 2 * 3 * 16 * 32, 4 * (4 + 9 + 5), 34
"""Bytes of a frame of the line world, and of what is stored beside it."""


def made(path: Path, *overrides: str) -> tuple[Recipe, Network]:
    recipe = resolve_recipe(path, overrides)
    return recipe, build_network(recipe, 0)


def need(recipe: Recipe, network: Network) -> dict[str, float]:
    stage = recipe.stages[0]
    whole = stage_need(network, recipe, stage, CPU, measure_kept(network, recipe, stage))
    return whole.host | whole.device


def test_a_rollout_is_counted_whole(line_recipe: Path) -> None:
    parts = need(*made(line_recipe))
    assert parts["a rollout of 16 steps of 2 environments"] == (3 + 16) * 2 * (IMAGES + VECTORS + STEP)
    # Two segments of eight frames, three before each.
    assert parts["a minibatch"] == 22 * (IMAGES + VECTORS)
    recipe, network = made(line_recipe, "stages.0.freeze=[spatial]")
    parts = need(recipe, network)
    assert parts["a rollout of 16 steps of 2 environments"] == (3 + 16) * 2 * (4 * 4 * 8 + VECTORS + STEP)
    assert parts["activations of 22 frames in the spatial encoder"] == 0
    assert all(p.requires_grad for p in network.parameters()), "the network is left as it was"


def test_activations_are_those_that_the_backward_pass_keeps(line_recipe: Path) -> None:
    recipe, network = made(line_recipe)
    kept = measure_kept(network, recipe, recipe.stages[0])
    # The convolution keeps its input (joined cameras) and tanh its output, 2 x 4 cells of 8; pooling shares the latter.
    assert kept.image == 4 * (2 * 3 * 16 * 32 + 8 * 2 * 4)
    parts = need(*made(line_recipe, "stages.0.microbatch=5"))
    assert parts["activations of 5 frames in the spatial encoder"] == pytest.approx(GRADIENTS * 5 * kept.image)


def test_streams_keep_a_state_for_each_segment(line_recipe: Path) -> None:
    recipe, network = made(line_recipe, "context={kind: stream}")
    state = 4 * 8 * (4 + 1 + 1)
    assert need(recipe, network)["states of the memory"] == 2 * 16 // 8 * state


def test_what_cannot_fit_is_refused_with_the_numbers(line_recipe: Path) -> None:
    recipe, network = made(line_recipe)
    total = sum(need(recipe, network).values())
    check_memory(network, recipe, CPU, lambda _: int(total) + 1)
    check_memory(network, recipe, CPU, lambda _: None)
    with pytest.raises(
        MemoryShortError, match=r"recipe 'line', stages.0: this stage needs .* are free: .*microbatch"
    ) as told:
        check_memory(network, recipe, CPU, lambda _: int(total) - 1)
    assert "activations of 22 frames" in str(told.value)


def test_advice_fits(line_recipe: Path) -> None:
    recipe, network = made(line_recipe, "stages.0.envs=64", "stages.0.workers=1")
    free = int(sum(need(recipe, network).values()) / 3)
    with pytest.raises(MemoryShortError, match=r"`envs: \d+`") as told:
        check_memory(network, recipe, CPU, lambda _: free)
    envs = str(told.value).split("`envs: ")[1].split("`")[0]
    fitting = [f"stages.0.envs={envs}", "stages.0.workers=1", "stages.0.microbatch=1"]
    check_memory(*reversed(made(line_recipe, *fitting)), CPU, lambda _: free)  # type: ignore[misc]


def test_a_gpu_is_asked_for_its_own_part(line_recipe: Path) -> None:
    recipe, network = made(line_recipe)
    free = {"cpu": 10**9, "cuda": 1000}
    with pytest.raises(MemoryShortError, match=r"of GPU memory and 0\.0 MB are free") as told:
        check_memory(network, recipe, torch.device("cuda"), lambda device: free[device.type])
    assert "rollout of" not in str(told.value).split("free:")[1].split("fit")[0]


def test_imitation_and_perception_count_their_pools(line_recipe: Path) -> None:
    recipe, network = made(line_recipe)
    same = {"envs": 2, "workers": 1, "rollout": 16, "minibatch": 16, "pool": 512}
    imitation = ImitationStage(kind="imitation", steps=64, segment=8, **same)
    perception = PerceptionStage(kind="perception", steps=64, held_out=10, **same)
    kept = measure_kept(network, recipe, imitation)
    # No more frames are kept than the stage has steps.
    held = stage_need(network, recipe, imitation, CPU, kept).host["a pool of 512 frames"]
    assert held == 64 * (IMAGES + VECTORS + STEP)
    held = stage_need(network, recipe, perception, CPU, kept).host["a pool of 512 frames"]
    assert held == (512 + 10) * (IMAGES + 200 * 200 + STEP)


def test_training_asks_before_it_begins(line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trainer, "check_memory", lambda *given: check_memory(*given, lambda _: 1))
    with pytest.raises(MemoryShortError):
        trainer.Trainer(resolve_recipe(line_recipe, []), tmp_path / "run", Display(1, 1), Stop())
    assert not (tmp_path / "run").exists()


def test_what_is_free_is_the_least_of_system_and_container(tmp_path: Path) -> None:
    proc = tmp_path / "meminfo"
    assert available_memory(proc, tmp_path) is None
    proc.write_text("MemTotal:       3000 kB\nMemAvailable:   2000 kB\n")
    assert available_memory(proc, tmp_path) == 2_048_000
    (tmp_path / "memory.max").write_text("max\n")
    (tmp_path / "memory.current").write_text("500000\n")
    assert available_memory(proc, tmp_path) == 2_048_000
    (tmp_path / "memory.max").write_text("1500000\n")
    assert available_memory(proc, tmp_path) == 1_000_000
    (tmp_path / "memory.stat").write_text("anon 7\ninactive_file 100000\n")
    assert available_memory(proc, tmp_path) == 1_100_000


def test_a_gpu_tells_what_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (700, 1000))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda _: 200)
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda _: 50)
    assert available_on(torch.device("cuda")) == 850
