"""Imitation on the fake world: it learns what the autopilot does, in the policy's own states, and survives stops."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.display import Display
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import Trainer

STAGE = (
    "kind: imitation, steps: 192, envs: 2, workers: 1, rollout: 32, segment: 8, minibatch: 16, epochs: 2, pool: 128, "
    "learning_rate: 0.01, checkpoint_every: 64"
)


def trainer(path: Path, run: Path, *overrides: str, stage: str = STAGE) -> Trainer:
    recipe = resolve_recipe(path, [f"stages=[{{{stage}}}]", *overrides])
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def weights(run: Path) -> dict[str, torch.Tensor]:
    return Controller.load(run).network.state_dict()


@pytest.mark.parametrize("overrides", [[], ["context={kind: stream}"], ["temporal=null", "policy.distribution=beta"]])
def test_cloning_reaches_what_the_autopilot_does(line_recipe: Path, tmp_path: Path, overrides: list[str]) -> None:
    """It always drives straight on with full throttle."""
    made = trainer(line_recipe, tmp_path / "run", *overrides, "stages.0.epochs=20")
    made.train()
    rows = read_metrics(tmp_path / "run")
    assert [row["steps"] for row in rows] == [64, 128, 192]
    assert [row["round"] for row in rows] == [0, 1, 2]
    assert rows[0]["autopilot_share"] == 1.0 and rows[0]["longitudinal_error"] is None
    assert rows[-1]["autopilot_share"] == 0.0
    assert rows[-1]["longitudinal_error"] < 0.25
    assert rows[-1]["steering_error"] < 0.1
    assert rows[-1]["collision_rate"] == 0.0
