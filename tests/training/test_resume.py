"""A run that was stopped ends with the weights and the log of one that was not, wherever it was stopped."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from me3bev_cli.errors import CheckpointError
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import checkpoints
from me3bev_cli.training.display import Display
from me3bev_cli.training.kill_check import rows, same_weights
from me3bev_cli.training.run import make_run
from me3bev_cli.training.sequence_ppo import SequencePPO
from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer

STAGE = "{kind: ppo, steps: 64, envs: 2, workers: 1, rollout: 16, segment: 8, minibatch: 16, checkpoint_every: 32}"


def trainer(path: Path, run: Path, *overrides: str) -> Trainer:
    recipe = resolve_recipe(path, overrides)
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def stop_at(one: Trainer, steps: int) -> None:
    """Have the run asked to stop when it has come to a step."""
    show = one.display.step

    def ask(line: Callable[[], dict[str, Any]]) -> None:
        show(line)
        one.stop.asked = one.progress.total_steps >= steps

    one.display.step = ask  # type: ignore[method-assign]


def check(recipe: Path, folder: Path, interrupted: Trainer, kept: int, *overrides: str) -> None:
    """Interrupt one run, go on with it, and compare it with another."""
    with pytest.raises(InterruptedTrainingError):
        interrupted.train()
    assert interrupted.progress.total_steps == kept
    assert checkpoints(interrupted.run)[-1].name == f"step_{kept:09d}"
    again = trainer(recipe, interrupted.run, *overrides)
    again.resume()
    assert again.progress.total_steps == kept
    again.train()
    trainer(recipe, folder / "whole", *overrides).train()
    assert same_weights(interrupted.run, folder / "whole")
    assert rows(interrupted.run) == rows(folder / "whole")


@pytest.mark.parametrize(
    "overrides",
    [
        [],
        ["context={kind: stream}"],
        ["stages.0.freeze=[spatial]", "policy.distribution=beta"],
        ["stages.0.freeze=[spatial]", "stages.0.guidance={weight: 2.0}", "stages.0.busiest_of=2"],
        [f"stages=[{STAGE}, {STAGE}]"],
    ],
)
def test_a_stop_in_the_middle_of_a_rollout(line_recipe: Path, tmp_path: Path, overrides: list[str]) -> None:
    short = [*overrides, *([] if "stages=" in str(overrides) else ["stages.0.steps=128"])]
    one = trainer(line_recipe, tmp_path / "run", *short)
    stop_at(one, 106)
    check(line_recipe, tmp_path, one, 96, *short)


def test_a_stop_before_the_first_rollout(line_recipe: Path, tmp_path: Path) -> None:
    one = trainer(line_recipe, tmp_path / "run", "stages.0.steps=64")
    one.stop.asked = True
    check(line_recipe, tmp_path, one, 0, "stages.0.steps=64")


def test_a_stop_in_an_update(line_recipe: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = trainer(line_recipe, tmp_path / "run", "stages.0.steps=128")
    train = SequencePPO.train

    def asked(model: SequencePPO) -> None:
        if model.num_timesteps == 96 and not one.stop.asked:
            # In the second of two epochs.
            left = [3]
            evaluate = model.policy.evaluate_actions

            def counted(*arguments: Any) -> Any:
                left[0] -= 1
                one.stop.asked = one.stop.asked or left[0] == 0
                return evaluate(*arguments)

            monkeypatch.setattr(model.policy, "evaluate_actions", counted)
        train(model)

    monkeypatch.setattr(SequencePPO, "train", asked)
    check(line_recipe, tmp_path, one, 64, "stages.0.steps=128")


def test_a_stop_while_episodes_are_played_again(line_recipe: Path, tmp_path: Path) -> None:
    one = trainer(line_recipe, tmp_path / "run")
    stop_at(one, 100)
    with pytest.raises(InterruptedTrainingError):
        one.train()
    again = trainer(line_recipe, one.run)
    again.resume()
    again.stop.asked = True
    with pytest.raises(InterruptedTrainingError):
        again.train()
    assert [path.name for path in checkpoints(one.run)] == ["step_000000064", "step_000000096"]


def test_a_state_of_another_kind_is_refused(line_recipe: Path, tmp_path: Path) -> None:
    one = trainer(line_recipe, tmp_path / "run")
    one.progress.stage_steps = one.progress.total_steps = 64
    one.save({"optimizer": {}})
    again = trainer(line_recipe, one.run)
    again.resume()
    with pytest.raises(CheckpointError, match="another version"):
        again.train()
