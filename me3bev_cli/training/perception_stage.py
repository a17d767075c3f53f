"""A `perception` stage: the spatial part learns the bird's-eye map and depth from frames with their truth.

In rounds: so many stretches of driving are drawn by seeds of their own, then learned from together with the last
rounds' frames. What the pool holds, and which frames each gradient step takes, are functions of the round's number, so
that a run that goes on draws the same frames again.
"""

from __future__ import annotations

import time
from collections import defaultdict
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.errors import UserError
from me3bev_cli.perception.batches import Pool
from me3bev_cli.perception.drawing import Drawer
from me3bev_cli.perception.frames import Frames, FrameSource, Job
from me3bev_cli.perception.grid import grid_of
from me3bev_cli.perception.learning import Learner
from me3bev_cli.perception.losses import balanced_weights
from me3bev_cli.perception.model import PerceptionModel, depth_bins_of
from me3bev_cli.perception.rounds import Rounds
from me3bev_cli.perception.scoring import shown_scores, tally
from me3bev_cli.perception.truth import classes_of, mirrored_cameras
from me3bev_cli.pipeline.assemble import configured, recipe_rig
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.alarms import guard_gradients
from me3bev_cli.training.trainer import InterruptedTrainingError
from me3bev_cli.workers import cores

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import PerceptionStage
    from me3bev_cli.training.trainer import Trainer


@dataclass
class Place:
    """Where in the stage it is."""

    round: int = 0
    update: int = 0
    """Gradient steps of the round that are done."""
    before: int = 0
    """Environment steps of the stage before the round."""
    begun: bool = False
    """Whether the round's own steps are in the trainer's count."""
    past: list[int] = field(default_factory=list)
    """`before` of each round in the pool that is over, the oldest first."""


class PerceptionRunner:
    """Runs a perception stage.

    Raises:
        UserError: the spatial part gives no bird's-eye grid.
    """

    def __init__(self, trainer: Trainer, stage: PerceptionStage) -> None:
        self.trainer, self.stage = trainer, stage
        recipe, number = trainer.recipe, trainer.progress.stage
        if recipe.spatial is None or trainer.network.spatial is None:
            raise UserError("a perception stage needs a spatial plugin and bev among the modalities")
        plugin, config = configured("spatial", recipe.spatial)
        self.rig = recipe_rig(recipe)
        grid = grid_of(plugin, recipe.spatial.name, config, self.rig)
        names = (recipe.seed, "perception", number)
        self.model = PerceptionModel(trainer.network, grid, stage.head_width, derive_seed(*names, "head"))
        mirror = mirrored_cameras(self.rig) if stage.mirror else None
        map = recipe.simulator_in(stage).map
        self.rounds = Rounds(stage, names, map, mirror is not None, self.model.stretches)
        self.pool = Pool(stage.pool, mirror, stage.hidden, max(grid.rows, grid.columns))
        self.place = Place()
        self.learner: Learner | None = None
        self._chance: Tensor | None = None

    def restore(self, state: dict[str, Any]) -> None:
        """Take up a round where it was left."""
        self.place = Place(**state["place"])
        self._chance = state["torch_random"]
        if state["learner"] is not None:
            self._make_learner(state["learner"]["class_weights"]).restore(state["learner"])

    def save(self) -> None:
        """Write a checkpoint, and the head where it can be found when the stage is over."""
        learner = None if self.learner is None else self.learner.state()
        self.trainer.save({"place": asdict(self.place), "learner": learner, "torch_random": torch.get_rng_state()})
        self.model.keep_head(self.trainer.run)

    def run(self) -> None:
        """Learn to the stage's last step."""
        stage = self.stage
        if self._chance is None:
            torch.manual_seed(derive_seed(*self.rounds.names, "chance"))
        else:
            torch.set_rng_state(self._chance)
        drawer = Drawer(self._source(), min(stage.envs, stage.workers or cores()))
        self.model.train()
        try:
            held_out = self._drawn(drawer, self.rounds.held_out())
            first = self.place.round - len(self.place.past)
            for number, before in enumerate(self.place.past, first):
                self.pool.add(self._drawn(drawer, self.rounds.jobs(number, before)))
            drawer.begin(self.rounds.jobs(self.place.round, self.place.before))
            while self.place.before < stage.steps:
                self._round(drawer, held_out)
            self.save()
        except InterruptedTrainingError:
            self.save()
            raise
        finally:
            drawer.close()

    def _source(self) -> FrameSource:
        recipe, stage = self.trainer.recipe, self.stage
        choice = recipe.simulator_in(stage)
        cls, config = configured("simulator", choice)
        return FrameSource(
            simulator=cls(config),
            observation=recipe.observation,
            density=choice.density,
            weather=recipe.weather_in(stage),
            every=stage.every,
            noise=stage.noise,
            roam=stage.roam,
            dress=stage.dress,
            depth=depth_bins_of(self.model.spatial, self.rig) if stage.depth else None,
        )

    def _drawn(self, drawer: Drawer, jobs: list[Job]) -> list[Frames]:
        drawer.begin(jobs)
        return drawer.take(self._check_stop)

    def _make_learner(self, class_weights: Tensor) -> Learner:
        spatial = self.trainer.network.spatial
        self.trainer.network.freeze([spatial] if spatial is not None and "spatial" in self.stage.freeze else [])
        self.learner = Learner(self.model, self.stage, class_weights)
        guard_gradients(self.learner.optimizer, self.model, self.trainer.run)
        return self.learner

    def _round(self, drawer: Drawer, held_out: list[Frames]) -> None:
        """Learn from the round that is being drawn, while the next one is."""
        place, stage, started = self.place, self.stage, time.monotonic()
        drawn = drawer.take(self._check_stop)
        steps = sum(frames.steps for frames in drawn)
        after = place.before + steps
        drawer.begin(self.rounds.jobs(place.round + 1, after))
        self.pool.add(drawn)
        place.past = place.past[len(place.past) + 1 - len(self.pool.rounds) :]
        if not place.begun:
            self.trainer.count(steps)
            place.begun = True
        learner = self.learner or self._make_learner(
            balanced_weights(_class_counts([*drawn, *held_out]), stage.balance)
        )
        row: dict[str, float | None] = {**self._learn(learner, drawer, drawn, steps)}
        if held_out and (_passed(stage.score_every, place.before, after) or after >= stage.steps):
            row |= self._scores(held_out, learner.autocast)
        saved = _passed(stage.checkpoint_every, place.before, after)
        self.place = Place(place.round + 1, before=after, past=[*place.past, place.before])
        self.trainer.progress.updates += 1
        row |= {"learning_rate": learner.rate(after), "steps_per_second": steps / (time.monotonic() - started)}
        self.trainer.log(row)
        if saved and after < stage.steps:
            self.save()

    def _scores(self, held_out: list[Frames], autocast: torch.dtype | None) -> dict[str, float]:
        """Of the maps of the grid, and of those of the tokens where these are learned from."""
        scores = shown_scores(tally(self.model, held_out, autocast, self._check_stop))
        if self.stage.tokens:
            of_tokens = tally(self.model, held_out, autocast, self._check_stop, tokens=True)
            scores |= shown_scores(of_tokens, "tokens_")
        return scores

    def _learn(self, learner: Learner, drawer: Drawer, drawn: list[Frames], steps: int) -> dict[str, float]:
        """A round's gradient steps; the means of its losses."""
        place = self.place
        kept = sum(len(frames) for frames in drawn)
        minibatches = self.rounds.minibatches(place.round, kept, len(self.pool))
        sums: defaultdict[str, float] = defaultdict(float)
        first = place.update
        while place.update < len(minibatches):
            self._check_stop()
            drawer.attend()
            batch = self.pool.batch(*minibatches[place.update], self.trainer.device)
            losses = learner.learn(batch, place.before + steps * place.update / len(minibatches))
            place.update += 1
            for name, loss in losses.items():
                sums[name] += float(loss)
            self.trainer.display.step(self.trainer.standing)
        return {name: total / (len(minibatches) - first) for name, total in sums.items()}

    def _check_stop(self) -> None:
        if self.trainer.stopping:
            raise InterruptedTrainingError


def _passed(every: int, before: int, after: int) -> bool:
    """Whether a multiple of `every` steps lies between two counts."""
    return after // every > before // every


def _class_counts(drawn: list[Frames]) -> Tensor:
    counts = sum(np.bincount(classes_of(frames.maps).ravel(), minlength=len(BEV_CLASSES)) for frames in drawn)
    return torch.as_tensor(counts)
