"""The training environments of a stage: several episodes side by side, each with a seed of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from stable_baselines3.common.vec_env import DummyVecEnv

from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.training.episodes import EpisodeMaker, Wrapping
from me3bev_cli.training.replay import ReplayedEnvs
from me3bev_cli.workers import cores

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.recipe_stages import DrivenStage


EPISODES_OF_A_STAGE = 1_000_000
"""More than a stage plays: the next one begins here, so that two stages on one map have episodes of their own."""


def first_episode_of(stage: int) -> int:
    """Index of the first episode of a recipe's stage, by the stage's number."""
    return stage * EPISODES_OF_A_STAGE


def _to_stderr(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr)


def make_environments(
    recipe: Recipe,
    stage: DrivenStage,
    first_episode: int = 0,
    around: Wrapping | None = None,
    told: Callable[[str], None] = _to_stderr,
    check: Callable[[], None] | None = None,
) -> ReplayedEnvs:
    """The stage's environments: in worker processes, or one after another in this one when there is one worker.

    What they play does not depend on the number of workers, nor on whether one of them had to be started again.

    Args:
        first_episode: index of the first episode to play: a run that goes on does not repeat what it has seen.
        around: wraps each environment, in the process in which it lives; can be pickled.
        told: called with a sentence when a worker has died or hangs and is started again.
        check: called a few times a second while a worker is silent; may raise to give up.
    """
    choice = recipe.simulator_in(stage)
    cls, config = configured("simulator", choice)
    simulator = cls(config)
    makers = [
        EpisodeMaker(
            simulator,
            recipe.observation,
            map=choice.map,
            density=choice.density,
            weather=recipe.weather_in(stage),
            images="bev" in recipe.modalities,
            run_seed=recipe.seed,
            first=first_episode + index,
            stride=stage.envs,
            around=around,
            terms=recipe.reward_in(stage),
            busiest_of=stage.busiest_of,
        )
        for index in range(stage.envs)
    ]
    workers = min(stage.envs, stage.workers or cores())
    envs = ParallelEnvs(makers, workers) if workers > 1 else DummyVecEnv(list(makers))
    return ReplayedEnvs(envs, [maker.first for maker in makers], stage.envs, told, stage.worker_timeout, check)
