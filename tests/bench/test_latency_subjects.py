"""What is compared: every pair of what is installed, recipes, runs, checkpoints."""

from __future__ import annotations

import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import Field

from me3bev_cli import registry
from me3bev_cli.api import PluginConfig
from me3bev_cli.bench import latency_subjects
from me3bev_cli.bench.latency_subjects import BASE, every_pair, named
from me3bev_cli.errors import CheckpointError, RecipeError
from me3bev_cli.pipeline.assemble import build_network
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.training.checkpoint import Progress, save_checkpoint
from me3bev_cli.training.run import make_run


class Needy:
    """A plugin that cannot be built without being told something."""

    class Config(PluginConfig):
        """One key without a default."""

        weights: str = Field(description="a file")


@pytest.fixture
def run(line_recipe: Path, tmp_path: Path) -> Path:
    """A run folder with two checkpoints."""
    recipe = resolve_recipe(line_recipe)
    folder = tmp_path / "runs" / "mine"
    make_run(folder, dump(recipe))
    for steps in (64, 128):
        save_checkpoint(folder, build_network(recipe, 0).state_dict(), recipe, Progress(total_steps=steps), {})
    return folder


def test_every_pair_of_what_is_shipped_at_full_size() -> None:
    subjects, skipped = every_pair()
    pairs = {(s.recipe.spatial.name, s.recipe.temporal.name, s.recipe.fusion.name) for s in subjects}  # type: ignore[union-attr]
    kinds = (registry.names(kind) for kind in ("spatial", "temporal", "fusion"))
    spatial, temporal, fusion = kinds
    assert pairs == {(a, b, c) for a in spatial for b in temporal for c in fusion}
    assert len(subjects) == len(pairs) >= 16
    assert skipped == []
    base = resolve_recipe(BASE)
    for subject in subjects:
        assert subject.recipe.observation == base.observation
        assert subject.recipe.context == base.context
    same = next(s for s in subjects if s.name == "lift_splat-mamba-sum")
    assert same.recipe.model_copy(update={"name": BASE}) == base


def test_what_cannot_be_built_is_left_out_with_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    real = registry.entry_points

    def entry_points(*, group: str) -> list[EntryPoint]:
        here = [EntryPoint("needy", f"{__name__}:Needy", group), EntryPoint("broken", "no_such_module_here:X", group)]
        return [*real(group=group), *(here if group == "me3bev.temporal" else [])]

    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__, SimpleNamespace(Needy=Needy)))
    monkeypatch.setattr(registry, "entry_points", entry_points)
    registry.clear()
    try:
        subjects, skipped = every_pair()
    finally:
        monkeypatch.undo()
        registry.clear()
    assert len(subjects) >= 16
    assert skipped[1] == "temporal plugin 'needy': its config needs weights"
    assert skipped[0].startswith("temporal plugin 'broken': temporal plugin 'broken'")


def test_a_pair_that_does_not_fit_is_left_out(line_recipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Vectors of 12 numbers do not divide into a transformer's four heads of an even width."""
    text = line_recipe.read_text().replace("nav: {hidden: [8], width: 8}", "nav: {hidden: [8], width: 12}")
    line_recipe.write_text(text.replace("{name: sum}", "{name: concat, width: 8}"))
    monkeypatch.setattr(latency_subjects, "BASE", str(line_recipe))
    subjects, skipped = every_pair()
    assert "tiny_test-gru-concat" in {subject.name for subject in subjects}
    assert "tiny_test-transformer-concat" not in {subject.name for subject in subjects}
    assert any(line.startswith("tiny_test-transformer-concat: 4 heads") for line in skipped)


def test_recipes_by_name_and_file(line_recipe: Path) -> None:
    found = named(["small", str(line_recipe), str(line_recipe)])
    assert [subject.name for subject in found] == ["small", "line-1", "line-2"]
    assert all(subject.checkpoint is None and subject.run is None for subject in found)
    with pytest.raises(RecipeError, match="unknown recipe 'smal'; did you mean 'small'"):
        named(["smal"])


def test_runs_and_checkpoints(run: Path, tmp_path: Path) -> None:
    last, first = named([str(run), str(run / "checkpoints" / "step_000000064")])
    assert (last.name, last.run, last.checkpoint) == ("mine", run, run / "checkpoints" / "step_000000128")
    assert (first.name, first.run) == ("mine-step_000000064", run)
    assert first.recipe.name == "line"
    (tmp_path / "empty").mkdir()
    with pytest.raises(CheckpointError, match="has no checkpoint yet"):
        named([str(tmp_path / "empty")])
    for file in ("policy.safetensors", "recipe.yaml"):
        (run / "checkpoints" / "step_000000128" / file).unlink()
        with pytest.raises(CheckpointError, match=f"step_000000128 has no {file}"):
            named([str(run)])
