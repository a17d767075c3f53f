"""Evaluation while training goes on: the same episodes each time, and the best policy so far kept as a checkpoint.

Nothing of it touches what training computes with: the weights, the optimiser, the episodes and the random states are
as they would be without.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from me3bev_cli.evaluation.course import CourseMaker, Visit
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.metrics import measure
from me3bev_cli.evaluation.side_by_side import drive, split
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.best import SCORE, read_best
from me3bev_cli.training.checkpoint import save_best
from me3bev_cli.training.curve import read_metrics
from me3bev_cli.workers import WorkerDiedError, cores

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.training.trainer import Trainer

COLUMNS = {
    SCORE: "driving_score",
    "eval_collision_rate": "collision_rate",
    "eval_completion": "route_completion",
    "eval_success": "success",
    "eval_reward_per_step": "return_per_step",
}
"""What an evaluation adds to the log -> the metric that it is the mean of."""

NOT_DRIVING = ("perception",)
"""Kinds of stages in which the policy does not learn to drive."""


@dataclass(frozen=True)
class Plan:
    """What is driven each time."""

    makers: tuple[CourseMaker, ...]

    @property
    def episodes(self) -> int:
        """In all."""
        return sum(len(maker.visits) for maker in self.makers)

    @classmethod
    def of(cls, recipe: Recipe) -> Plan:
        """The recipe's: `episodes` on each of its maps and densities, in the weather of training.

        The seeds are the same for every run, so that runs compare, and none of them is ever trained on or used by
        `me3bev eval`, so that the choice of the best does not favour it there.
        """
        plan, world = recipe.evaluation, recipe.simulator
        visits = [
            Visit(map, density, index, derive_seed("periodic evaluation", map, density, index))
            for density in plan.densities or (world.density,)
            for map in plan.maps or (world.map,)
            for index in range(plan.episodes)
        ]
        plugin, config = configured("simulator", world)
        images = "bev" in recipe.modalities
        return cls(
            tuple(
                CourseMaker(plugin(config), recipe.observation, recipe.weather.training, images, course)
                for course in split(visits, plan.envs)
            )
        )


class Evaluations:
    """Evaluates a run's policy every so many environment steps, and keeps the best.

    Args:
        trainer: whose network is judged, and who logs the figures.
    """

    def __init__(self, trainer: Trainer) -> None:
        self.trainer = trainer
        self.every = trainer.recipe.evaluation.every
        self._last: int | None = None

    def when_due(self, at_end: bool = False) -> None:
        """Evaluate if it is time; to be called where the weights rest, between two updates.

        Args:
            at_end: it is time, too, unless it has been done at this very step.
        """
        trainer = self.trainer
        kind = trainer.recipe.stages[trainer.progress.stage].kind
        if self.every is None or kind in NOT_DRIVING or trainer.stopping:
            return
        since = trainer.progress.total_steps - self.last
        if since >= self.every or (at_end and since > 0):
            self._evaluate()

    @property
    def last(self) -> int:
        """The step of the newest evaluation in the log; 0 when there is none."""
        if self._last is None:
            steps = [row["steps"] for row in read_metrics(self.trainer.run) if row.get(SCORE) is not None]
            self._last = max(steps, default=0)
        return self._last

    def _evaluate(self) -> None:
        trainer, begun = self.trainer, time.monotonic()
        episodes = self._drive()
        if episodes is None:
            return
        values = [measure(episode) for episode in episodes]
        figures: dict[str, float | None] = {
            column: _mean([v[name] for v in values]) for column, name in COLUMNS.items()
        }
        figures |= {"eval_episodes": len(episodes), "eval_seconds": round(time.monotonic() - begun, 1)}
        self._last = trainer.progress.total_steps
        best = read_best(trainer.run)
        score = figures[SCORE]
        if score is not None and (best is None or score > best[SCORE]):
            # Kept before it is told: a best that the log knows of is there.
            save_best(trainer.run, trainer.network, trainer.recipe, trainer.progress, figures)
        trainer.log(figures)

    def _drive(self) -> list[Episode] | None:
        """The episodes; None when training is to stop, or when worker processes die over and over."""
        trainer = self.trainer
        makers = Plan.of(trainer.recipe).makers
        workers = trainer.recipe.stages[trainer.progress.stage].workers or cores()
        for _ in range(2):
            try:
                return drive(trainer.network, makers, workers, trainer.recipe.name, lambda: trainer.stopping)
            except WorkerDiedError as error:
                trainer.display.say(f"evaluation at step {trainer.progress.total_steps:,}: {error}")
        return None


def _mean(values: list[float]) -> float | None:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else None
