"""A run that begins with another one's perception ends with the very weights that it would have learned by itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from typer.testing import CliRunner, Result

from me3bev_cli.errors import RunError
from me3bev_cli.main import app
from me3bev_cli.perception.model import load_model
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.training.batch import prepare
from me3bev_cli.training.checkpoint import FOLDER, WEIGHTS, checkpoints
from me3bev_cli.training.curve import read_metrics

PERCEPTION = (
    "{kind: perception, steps: 32, envs: 2, rollout: 16, every: 4, pool: 16, uses: 2, minibatch: 4, workers: 1,"
    " held_out: 0, checkpoint_every: 64, head_width: 8, learning_rate: 0.01}"
)
PPO = "{kind: ppo, steps: 32, envs: 2, rollout: 8, segment: 8, minibatch: 16, epochs: 1, workers: 1, freeze: [spatial]}"


def options(perception: str = PERCEPTION, ppo: str = PPO, *more: str) -> list[str]:
    settings = ("spatial.name=tiny_grid", f"stages=[{perception}, {ppo}]", *more)
    return [word for setting in settings for word in ("--set", setting)]


def train(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["train", *map(str, arguments)])


def weights(run: Path) -> dict[str, torch.Tensor]:
    return Controller.load(run).network.state_dict()


@pytest.fixture
def source(line_recipe: Path, tmp_path: Path) -> Path:
    """A run whose eyes were frozen after perception."""
    run = tmp_path / "source"
    result = train(line_recipe, "--out", run, *options())
    assert result.exit_code == 0, result.output
    return run


def told(run: Path) -> list[dict[str, Any]]:
    """The log without what depends on the clock."""
    return [{k: v for k, v in row.items() if "second" not in k} for row in read_metrics(run)]


def test_it_is_the_run_that_it_would_have_been(line_recipe: Path, source: Path, tmp_path: Path) -> None:
    other = options(PERCEPTION, PPO.replace("epochs: 1", "epochs: 2"), "temporal={name: lstm}", "fusion={name: concat}")
    assert train(line_recipe, "--out", tmp_path / "alone", *other).exit_code == 0
    result = train(line_recipe, "--out", tmp_path / "after", "--perception", source, *other)
    assert result.exit_code == 0, result.output
    assert "going on from step 32" in result.output
    alone, after = weights(tmp_path / "alone"), weights(tmp_path / "after")
    assert [key for key in alone if not torch.equal(alone[key], after[key])] == []
    assert alone.keys() != weights(source).keys()
    assert told(tmp_path / "after") == told(tmp_path / "alone")
    load_model(Controller.load(tmp_path / "after").network, tmp_path / "after")


def test_stopped_between_its_stages_it_goes_on_exactly(line_recipe: Path, source: Path, tmp_path: Path) -> None:
    """Gradients of perception that were still there must not count in the next stage, where its part is frozen."""
    for folder in checkpoints(source):
        if folder.name != "step_000000032":
            (tmp_path / "apart").mkdir(exist_ok=True)
            folder.rename(tmp_path / "apart" / folder.name)
    log = told(source)
    result = train("--resume", source)
    assert result.exit_code == 0, result.output
    whole, resumed = (load_file(place / "step_000000064" / WEIGHTS) for place in (tmp_path / "apart", source / FOLDER))
    assert [key for key in whole if not torch.equal(whole[key], resumed[key])] == []
    assert told(source) == log


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        (options(PERCEPTION.replace("uses: 2", "uses: 3")), "stages.0.uses: 3.0, there 2.0"),
        (options(PERCEPTION, PPO, "seed=1"), "seed: 1, there 3"),
        (options(PPO, PPO), "no stages after perception ones at its beginning"),
    ],
)
def test_another_perception_is_refused_and_nothing_is_made(
    line_recipe: Path, source: Path, tmp_path: Path, changed: list[str], named: str
) -> None:
    result = train(line_recipe, "--out", tmp_path / "after", "--perception", source, *changed)
    assert result.exit_code == 2
    assert "--perception" in result.output
    assert named in " ".join(result.output.split())
    assert not (tmp_path / "after").exists()


def test_damaged_eyes_are_refused_and_nothing_is_made(line_recipe: Path, source: Path, tmp_path: Path) -> None:
    for folder in checkpoints(source):
        (folder / WEIGHTS).write_bytes((folder / WEIGHTS).read_bytes()[:200])
    result = train(line_recipe, "--out", tmp_path / "after", "--perception", source, *options())
    assert result.exit_code == 2
    assert "damaged or truncated" in " ".join(result.output.split())
    assert not (tmp_path / "after").exists()


def test_eyes_that_learned_on_are_refused(line_recipe: Path, tmp_path: Path) -> None:
    """After perception the other run went on with its eyes: what is left is not what perception taught."""
    moving = PPO.replace(", freeze: [spatial]", ", checkpoint_every: 16")
    run = tmp_path / "moving"
    assert train(line_recipe, "--out", run, *options(PERCEPTION, moving)).exit_code == 0
    for folder in (run / "checkpoints").glob("step_*"):
        # As it is when the older ones have been pruned.
        if json.loads((folder / "progress.json").read_text())["total_steps"] <= 32:
            for file in folder.iterdir():
                file.unlink()
            folder.rmdir()
    result = train(line_recipe, "--out", tmp_path / "after", "--perception", run, *options())
    assert result.exit_code == 2
    assert "has no checkpoint of the end of its perception" in " ".join(result.output.split())


def test_a_batch_begins_with_it_where_there_is_perception(line_recipe: Path, source: Path, tmp_path: Path) -> None:
    blind = tmp_path / "blind.yaml"
    blind.write_text(f"name: blind\nextends: {line_recipe.name}\nstages: [{PPO.replace(', freeze: [spatial]', '')}]\n")
    seeing = tmp_path / "seeing.yaml"
    seeing.write_text(
        f"name: seeing\nextends: {line_recipe.name}\nspatial: {{name: tiny_grid}}\nstages: [{PERCEPTION}, {PPO}]\n"
    )
    runs = prepare([str(blind), str(seeing)], None, [], tmp_path / "batch", source)
    assert checkpoints(runs[0]) == []
    assert [row["steps"] for row in read_metrics(runs[1])] == [32]
    same = weights(runs[1]), weights(source)
    assert [key for key in same[0] if key.startswith("spatial") and not torch.equal(same[0][key], same[1][key])] == []
    seeing.write_text(seeing.read_text().replace("uses: 2", "uses: 3"))
    with pytest.raises(RunError, match="another perception"):
        prepare([str(blind), str(seeing)], None, [], tmp_path / "other", source)
    assert not (tmp_path / "other").exists()
