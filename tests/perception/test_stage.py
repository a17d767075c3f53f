"""The perception stage, end to end on the fake world: it learns, stops, goes on exactly and refuses what cannot be."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest
import torch
from fakes import LineEnv

from me3bev_cli.errors import CheckpointError, RecipeError, UserError
from me3bev_cli.perception.learning import Learner
from me3bev_cli.perception.model import HEAD, load_model
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import dump, resolve_recipe
from me3bev_cli.stopping import Stop
from me3bev_cli.training.checkpoint import checkpoints, find_checkpoint, load_progress
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.training.display import Display
from me3bev_cli.training.run import make_run
from me3bev_cli.training.trainer import InterruptedTrainingError, Trainer


def trainer(path: Path, run: Path, overrides: list[str]) -> Trainer:
    recipe = resolve_recipe(path, overrides)
    if not run.exists():
        make_run(run, dump(recipe))
    return Trainer(recipe, run, Display(sum(s.steps for s in recipe.stages), len(recipe.stages)), Stop())


def learned(run: Path) -> dict[str, torch.Tensor]:
    network = Controller.load(run).network
    return {**network.state_dict(), **load_model(network, run).heads().state_dict()}


def assert_same(one: dict[str, torch.Tensor], other: dict[str, torch.Tensor]) -> None:
    assert [key for key in one if not torch.equal(one[key], other[key])] == []


def test_it_learns_and_keeps_its_head(line_recipe: Path, overrides: list[str], run: Path) -> None:
    made = trainer(line_recipe, run, overrides)
    before = {key: value.clone() for key, value in made.network.state_dict().items()}
    last = made.train()
    rows = read_metrics(run)
    assert [row["steps"] for row in rows] == [32, 64, 96]
    assert rows[-1]["loss"] < rows[0]["loss"]
    assert rows[-1]["token_loss"] < rows[0]["token_loss"]
    assert "tokens_near_vehicle" in rows[-1]
    assert {"segmentation_loss", "dice_loss", "token_loss", "depth_loss", "learning_rate", "steps_per_second"} <= set(
        rows[0]
    )
    assert ["near_road" in row for row in rows] == [False, True, True]
    assert load_progress(last).done
    after = learned(run)
    moved = {key.split(".")[0] for key, value in before.items() if not torch.equal(after[key], value)}
    assert moved == {"spatial"}


def test_a_frozen_spatial_part_stays(line_recipe: Path, overrides: list[str], run: Path) -> None:
    made = trainer(line_recipe, run, [*overrides, "stages.0.freeze=[spatial]"])
    before = {key: value.clone() for key, value in made.network.state_dict().items()}
    made.train()
    assert_same(before, Controller.load(run).network.state_dict())


@pytest.fixture
def whole(line_recipe: Path, overrides: list[str], tmp_path: Path) -> dict[str, torch.Tensor]:
    """What an undisturbed run learns."""
    trainer(line_recipe, tmp_path / "whole", overrides).train()
    return learned(tmp_path / "whole")


@pytest.mark.parametrize("stop_at", [1, 5, 9])
def test_stopped_in_a_round_it_goes_on_exactly(
    line_recipe: Path,
    overrides: list[str],
    run: Path,
    whole: dict[str, torch.Tensor],
    monkeypatch: pytest.MonkeyPatch,
    stop_at: int,
) -> None:
    first = trainer(line_recipe, run, overrides)
    learn, done = Learner.learn, []

    def counted(self: Learner, batch: Any, step: float) -> Any:
        done.append(step)
        first.stop.asked = len(done) == stop_at
        return learn(self, batch, step)

    monkeypatch.setattr(Learner, "learn", counted)
    with pytest.raises(InterruptedTrainingError):
        first.train()
    monkeypatch.undo()
    again = trainer(line_recipe, run, overrides)
    again.resume()
    again.train()
    assert_same(whole, learned(run))
    assert [row["steps"] for row in read_metrics(run)] == [32, 64, 96]


def test_stopped_while_it_draws_it_goes_on_exactly(
    line_recipe: Path, overrides: list[str], run: Path, whole: dict[str, torch.Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    first = trainer(line_recipe, run, overrides)
    truth, drawn = LineEnv.camera_truth, []

    def counted(self: LineEnv) -> Any:
        drawn.append(self.steps)
        first.stop.asked = len(drawn) > 4
        return truth(self)

    monkeypatch.setattr(LineEnv, "camera_truth", counted)
    with pytest.raises(InterruptedTrainingError):
        first.train()
    monkeypatch.undo()
    again = trainer(line_recipe, run, overrides)
    again.resume()
    again.train()
    assert_same(whole, learned(run))


def test_after_a_kill_it_goes_on_from_the_last_checkpoint_exactly(
    line_recipe: Path, overrides: list[str], run: Path, whole: dict[str, torch.Tensor]
) -> None:
    """The log is ahead of the newest checkpoint that was left."""
    trainer(line_recipe, run, overrides).train()
    for folder in checkpoints(run)[1:]:
        shutil.rmtree(folder)
    again = trainer(line_recipe, run, overrides)
    again.resume()
    assert again.progress.total_steps == 64
    again.train()
    assert_same(whole, learned(run))


def test_what_is_learned_does_not_depend_on_workers(line_recipe: Path, overrides: list[str]) -> None:
    """Worker processes know no fakes, so the real world it is."""
    from me3bev_cli.api import ObservationConfig
    from me3bev_cli.perception.drawing import Drawer
    from me3bev_cli.perception.frames import FrameSource, Job
    from me3bev_cli.perception.truth import DepthBins
    from me3bev_plugins.simulator.highway import Highway

    observation = ObservationConfig(height=16, width=32, cameras=("front", "back"))
    bins = DepthBins((2.0, 10.0, 50.0), (2, 4), (16, 32))
    jobs = [Job((7, k), 6, "T1") for k in range(3)]

    def drawn(workers: int) -> list[Any]:
        source = FrameSource(Highway(Highway.Config()), observation, "low", None, every=4, noise=0.2, depth=bins)
        drawer = Drawer(source, workers)
        try:
            drawer.begin(jobs)
            return drawer.take(lambda: None)
        finally:
            drawer.close()

    for here, there in zip(drawn(1), drawn(2), strict=True):
        assert (len(here), here.steps) == (2, 6)
        for key in ("images", "maps", "depth"):
            assert (getattr(here, key) == getattr(there, key)).all()


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (["spatial.name=tiny_test"], "the spatial plugin 'tiny_test' gives no bird's-eye grid"),
        (["modalities=[vr, nav]"], "a perception stage needs bev among the modalities"),
        (["stages.0.minibatch=32"], "minibatch 32 is more than pool 16 frames"),
    ],
)
def test_recipes_that_cannot_learn_it_are_refused(
    line_recipe: Path, overrides: list[str], changed: list[str], told: str
) -> None:
    with pytest.raises(RecipeError) as caught:
        resolve_recipe(line_recipe, [*overrides, *changed])
    assert told in str(caught.value)


def test_a_grid_of_another_extent_is_refused(line_plugins: None) -> None:
    from fakes import TinyGrid

    from me3bev_cli.perception.grid import grid_of

    class Far(TinyGrid):
        @classmethod
        def grid_spec(cls, config: Any, rig: Any) -> Any:
            return super().grid_spec(config, rig)._replace(x_range=(-20.0, 80.0))

    with pytest.raises(UserError, match=r"x_range of the grid is \[-20.0, 80.0\], the truth .* from -50 to 50 m"):
        grid_of(Far, "far", None, None)  # type: ignore[arg-type]


def test_a_run_without_a_head_says_so(line_recipe: Path, overrides: list[str], run: Path) -> None:
    trainer(line_recipe, run, overrides).train()
    network = Controller.load(find_checkpoint(run)).network
    (run / HEAD).write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match="is damaged or of another make"):
        load_model(network, run)
    (run / HEAD).unlink()
    with pytest.raises(CheckpointError, match="no perception stage was trained in it"):
        load_model(network, run)
