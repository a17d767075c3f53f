"""The spatial bench measures what it says, and its contestants compute the same; no figure is judged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from me3bev_cli.bench.cumulative_sum import cumulative_sum_splat
from me3bev_cli.bench.latency_network import random_observation
from me3bev_cli.bench.spatial import TARGETS, main, take_turns
from me3bev_cli.bench.spatial_contestants import Encoders, Splats, Steps, published, splatting
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.transfer import to_tensors
from me3bev_cli.recipe_loading import resolve_recipe

SETS = ["spatial.stride=16", "spatial.trunk=mobilenet_v3_small"]


def test_every_figure_is_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "bench.json"
    sets = [part for change in SETS for part in ("--set", change)]
    before = torch.get_num_threads()
    assert main(["--recipe", "quickstart", *sets, "--rounds", "2", "--threads", "1", "--json", str(target)]) == 0
    assert torch.get_num_threads() == before
    data = json.loads(target.read_text())
    for key in (*TARGETS, "splat_sorted_ratio", "splat_backward_ratio", "floor_ratio", "bf16_ratio"):
        assert data[key] > 0
    assert set(data["encoder_parts"]) == {"recipe", "resnet"}
    assert {"trunk", "head", "bev_trunk"} <= set(data["encoder_parts"]["recipe"])
    assert all(0 < error < 0.1 for found in data["bf16_error"].values() for error in found.values())
    assert data["setup"]["threads"] == 1
    text = capsys.readouterr().out
    assert "wanted: 15 or more" in text
    assert "error of bf16 against fp32" in text


def test_all_splats_give_the_same() -> None:
    splats = Splats(resolve_recipe("quickstart"))
    ours, sorting, prepared = (run() for run in splats.forward.values())
    torch.testing.assert_close(ours, sorting, rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(prepared, sorting, rtol=1e-4, atol=1e-3)
    for mine, theirs in zip(*(run() for run in splats.backward.values()), strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-3, atol=1e-3)


def test_encoding_anew_decides_as_encoding_once() -> None:
    """Four frames one by one, and the window of four with the cumulative sum, come to the same action and value."""
    recipe = resolve_recipe("quickstart")
    once, anew = (build_network(recipe, 0).eval() for _ in range(2))
    module = splatting(anew)
    module.pool = published(module)
    frames = to_tensors(random_observation(recipe, 4), torch.device("cpu"))
    starts = torch.tensor([True, False, False, False])
    state = once.initial_state(1)
    with torch.no_grad():
        for n in range(4):
            decision, state = once.step(
                {key: part[n : n + 1] for key, part in frames.items()}, state, starts[n : n + 1]
            )
        other = anew.evaluate(frames, None, starts[None])
    torch.testing.assert_close(other.actions.mode(), decision.actions.mode(), rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(other.values, decision.values, rtol=1e-4, atol=1e-5)


def test_steps_count_their_operations() -> None:
    recipe = resolve_recipe("quickstart")
    steps = Steps(recipe, recipe)
    assert steps.length == 4
    assert steps.flops["step"] == steps.flops["step_resnet"] > 0
    assert {run().shape for run in steps.contestants.values()} == {(1, 2)}
    together, singly = (steps.contestants[f"step_encoding_anew{way}"]() for way in ("", "_singly"))
    torch.testing.assert_close(singly, together, rtol=1e-4, atol=1e-5)


def test_encoders_differ_only_in_how_they_compute() -> None:
    encoders = Encoders({"recipe": resolve_recipe("quickstart")})
    exact, half, plain = (run().tokens for run in encoders.contestants.values())
    torch.testing.assert_close(plain, exact, rtol=1e-4, atol=1e-4)
    assert 0 < float((half - exact).norm() / exact.norm()) < 0.05


def test_a_recipe_without_a_splat_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--recipe", "e2e_cla", "--rounds", "1", "--threads", "1"]) == 2
    assert "FlatCNN has no splat to time. Name a recipe whose spatial plugin is lift_splat" in capsys.readouterr().err


def test_turns_begin_with_another_each_time() -> None:
    calls: list[str] = []
    times: dict[str, list[float]] = {}
    take_turns({name: lambda name=name: calls.append(name) for name in "abc"}, times, 3)  # type: ignore[misc]
    assert "".join(calls) == "abcbcacab"
    assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 3, "c": 3}


def test_the_cumulative_sum_by_hand() -> None:
    """Two points of weights 1/4 and 1/2 with the features 8 and 2 in cell 1; one outside; one alone in cell 3."""
    probability = torch.tensor([0.25, 0.5, 0.1, 1.0]).view(1, 1, 1, 1, 4)
    context = torch.tensor([8.0, 2.0, 7.0, 3.0]).view(1, 1, 1, 1, 4)
    cells = torch.tensor([1, 1, -1, 3]).view(1, 1, 1, 4)
    assert cumulative_sum_splat(probability, context, cells, 4).flatten().tolist() == [0, 3, 0, 3]
    order = torch.tensor([0, 1, 3])
    assert cumulative_sum_splat(probability, context, cells, 4, order).flatten().tolist() == [0, 3, 0, 3]
