"""The bench times what it says: every stage, every network, every context; and it calls what drives."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from me3bev_cli.bench.latency import Effort, Measured, measure
from me3bev_cli.bench.latency_memory import Context, contexts, memory_for, state_after
from me3bev_cli.bench.latency_network import STAGES, Bench, Conditions
from me3bev_cli.bench.latency_rows import WHOLE, csv_text, over_budget, rows
from me3bev_cli.bench.latency_subjects import Subject
from me3bev_cli.bench.machine_ceilings import Ceilings
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.pipeline.memory import StreamMemory, WindowMemory
from me3bev_cli.pipeline.tree import map_tree
from me3bev_cli.recipe_loading import resolve_recipe

CPU = Conditions(torch.device("cpu"))
TEMPORAL = ("mamba", "gru", "lstm", "transformer")


def ceilings() -> Ceilings:
    return Ceilings(CPU.device, torch.float32, side=32, read=1 << 16)


def subject(path: Path, *overrides: str) -> Subject:
    recipe = resolve_recipe(path, overrides)
    return Subject(recipe.name, recipe)


def quick(subjects: list[Subject], lengths: list[int] | None, conditions: Conditions = CPU, **more: Any) -> Measured:
    effort = Effort(warmup=1, repeats=4, seconds=60)
    return measure(subjects, conditions, effort, lengths, ceilings=ceilings(), **more)


def test_rows_hold_every_stage_and_context(line_recipe: Path) -> None:
    measured = quick([subject(line_recipe), subject(line_recipe, "name=none", "temporal=null")], [2, 8])
    found = rows(measured)
    assert [(row["name"], row["context"], row["length"]) for row in found] == [
        ("line", "window", 2),
        ("line", "window", 8),
        ("line", "stream", 2),
        ("line", "stream", 8),
        ("none", "none", 1),
    ]
    for row in found:
        assert list(row["stages"]) == list(STAGES)
        assert row["calls"] == 4
        assert 0 < row["median_ms"] <= row["p95_ms"] <= row["p99_ms"]
        assert row["frames_per_s"] == pytest.approx(1000 / row["median_ms"])
        assert row["floor_ratio"] == pytest.approx(row["median_ms"] / row["floor_ms"])
        details = row["stage_details"]
        assert row["flops"] == sum(detail["flops"] for detail in details.values())
        assert row["parameters"] == sum(detail["parameters"] for detail in details.values())
    assert (found[0]["spatial"], found[0]["temporal"]) == ("tiny_test", "gru")
    assert found[-1]["temporal"] is None


def test_the_whole_of_a_call_is_the_sum_of_its_stages(line_recipe: Path) -> None:
    measured = quick([subject(line_recipe)], [4])
    variant = measured.variants[0]
    variant.samples = [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], [2.0, 2.0, 3.0, 4.0, 5.0, 6.0], [9.0, 2.0, 3.0, 4.0, 5.0, 6.0]]
    row = rows(measured)[0]
    assert row["median_ms"] == 22
    assert row["stages"]["sensor"] == 2
    # Three sorted values: the 95th percentile lies 0.9 of the way from the second to the third.
    assert row["p95_ms"] == pytest.approx(22 + 0.9 * (29 - 22))


def test_a_recipes_own_context_comes_with_the_usual_ones(line_recipe: Path) -> None:
    window = contexts(resolve_recipe(line_recipe, ["context.length=6"]), None)
    assert [c.length for c in window if c.kind == "window"] == [4, 6, 16, 64, 256, 1024]
    assert [c.length for c in window if c.kind == "stream"] == [4, 16, 64, 256, 1024]
    assert [c for c in window if c.own] == [Context("window", 6, True)]
    stream = contexts(resolve_recipe(line_recipe, ["context={kind: stream}"]), [3])
    assert stream == [Context("window", 3, False), Context("stream", 3, True)]
    assert contexts(resolve_recipe(line_recipe, ["temporal=null"]), [3]) == [Context("none", 1, True)]


@pytest.mark.parametrize("context", ["{kind: window, length: 4}", "{kind: stream}"])
@pytest.mark.parametrize("distribution", ["gaussian", "beta"])
def test_the_bench_calls_what_drives(line_recipe: Path, context: str, distribution: str) -> None:
    """From the same memory the timed path gives the action that the controller gives."""
    it = subject(line_recipe, f"context={context}", f"policy.distribution={distribution}")
    bench = Bench(it, CPU, [4])
    own = next(variant for variant in bench.variants if variant.context.own)
    controller = Controller(bench.network, it.recipe)
    controller.state = map_tree(torch.clone, own.state)
    controller.starts = torch.zeros(1, dtype=torch.bool)
    for _ in range(3):
        bench.turn([own])
        action = controller.act({key: value[0] for key, value in bench.observation.items()})
        assert own.action is not None
        np.testing.assert_allclose(own.action[0], action, atol=1e-6)
    assert len(own.samples) == 3


@pytest.mark.parametrize("name", TEMPORAL)
def test_a_stream_has_read_the_frames_that_it_says(line_recipe: Path, name: str) -> None:
    """Its state is the one that stepping through length - 1 frames of the same noise gives."""
    recipe = resolve_recipe(line_recipe, [f"temporal={{name: {name}}}"])
    network, context = build_network(recipe, 0).eval(), Context("stream", 70, False)
    memory = memory_for(network, recipe, context)
    assert isinstance(memory, StreamMemory)
    torch.manual_seed(1)
    found = state_after(memory, network, context, 1)
    torch.manual_seed(1)
    for modality, module in memory.temporal.items():
        tokens, width = network.embedding_shapes[modality]
        x = torch.cat([torch.randn(tokens, part, width) for part in (64, 5)], 1)
        state: Any = module.initial_state(tokens)  # type: ignore[operator]
        with torch.no_grad():
            for t in range(69):
                _, state = module(x[:, t : t + 1], state, torch.zeros(tokens, 1, dtype=torch.bool))
        map_tree(lambda a, b: torch.testing.assert_close(a[0], b, atol=1e-5, rtol=1e-4), found[modality], state)


def test_a_look_back_follows_the_length_with_the_same_weights(line_recipe: Path) -> None:
    recipe = resolve_recipe(line_recipe, ["temporal={name: transformer, context: 4}"])
    network = build_network(recipe, 0)
    memory = memory_for(network, recipe, Context("window", 32, False))
    assert isinstance(memory, WindowMemory)
    assert memory.length == 32
    assert {module.config.context for module in memory.temporal.values()} == {32}  # type: ignore[union-attr]
    assert network.memory.temporal["vr"].config.context == 4
    for key, value in memory.state_dict().items():
        torch.testing.assert_close(value, network.memory.state_dict()[key])


@pytest.mark.parametrize("name", TEMPORAL)
def test_bf16_and_batches(line_recipe: Path, name: str) -> None:
    conditions = Conditions(torch.device("cpu"), torch.bfloat16, batch=3)
    measured = quick([subject(line_recipe, f"temporal={{name: {name}}}")], [4], conditions)
    for row in rows(measured):
        assert row["frames_per_s"] == pytest.approx(3000 / row["median_ms"])
    for variant in measured.variants:
        assert variant.action is not None
        assert variant.action.shape == (3, 2)
        assert np.isfinite(variant.action).all()


def test_slow_contexts_get_fewer_calls(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that has used its share of the seconds stops after the least number of calls."""
    turn = Bench.turn

    def slow_windows(self: Bench, due: Any, keep: bool = True) -> Any:
        return {v: 100.0 if v.context.kind == "window" else 0.0 for v in turn(self, due, keep)}

    monkeypatch.setattr(Bench, "turn", slow_windows)
    measured = measure([subject(line_recipe)], CPU, Effort(1, 6, 60), [4], ceilings=ceilings())
    assert [(v.context.kind, len(v.samples)) for v in measured.variants] == [("window", 3), ("stream", 6)]


def test_stopping_keeps_what_was_measured(line_recipe: Path) -> None:
    asked: list[int] = []

    def stopped() -> bool:
        asked.append(1)
        # Two networks are built, then the first has one turn.
        return len(asked) > 4

    two = [subject(line_recipe), subject(line_recipe, "name=second")]
    measured = quick(two, [4], stopped=stopped)
    assert measured.stopped
    assert {(v.bench.subject.name, len(v.samples)) for v in measured.variants} == {("line", 1)}
    assert len(rows(measured)) == 2


def test_progress_says_how_long_it_will_take(line_recipe: Path) -> None:
    seen: list[tuple[str, int, int, bool]] = []

    def progress(what: str, done: int, total: int, left: float | None) -> None:
        seen.append((what, done, total, left is not None))

    quick([subject(line_recipe), subject(line_recipe, "name=second")], [4], progress=progress)
    assert seen[:2] == [("building", 0, 2, False), ("building", 1, 2, True)]
    assert seen[2:] == [("timing", n, 4, n > 0) for n in range(4)]


def test_memory_counts_weights_state_and_the_largest_stage(line_recipe: Path) -> None:
    measured = quick([subject(line_recipe)], [4, 400])
    short, long = (v for v in measured.variants if v.context.kind == "window")
    weights = 4 * short.parameters()
    assert short.peak_bytes() > weights
    # 396 more frames of 4 tokens of 8 and two vectors of 8, each held once and joined to the next frame once.
    assert long.peak_bytes() - short.peak_bytes() > 2 * 396 * 6 * 8 * 4


def test_csv_has_the_rows(line_recipe: Path) -> None:
    found = rows(quick([subject(line_recipe)], [4]))
    read = list(csv.DictReader(io.StringIO(csv_text(found))))
    assert [row["context"] for row in read] == ["window", "stream"]
    for row, mine in zip(read, found, strict=True):
        assert set(WHOLE) < set(row)
        assert float(row["median_ms"]) == mine["median_ms"]
        assert float(row["spatial_p95_ms"]) == mine["stage_details"]["spatial"]["p95_ms"]


def test_what_a_budget_judges() -> None:
    found = [
        {"name": "a", "own": True, "p95_ms": 50.0},
        {"name": "b", "own": False, "p95_ms": 150.0},
        {"name": "c", "own": True, "p95_ms": 100.1},
    ]
    assert [row["name"] for row in over_budget(found, 100, every=False)] == ["c"]
    assert [row["name"] for row in over_budget(found, 100, every=True)] == ["b", "c"]
