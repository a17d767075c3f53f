"""The training environments of a stage: several episodes side by side, each with a seed of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from me3bev_cli.parallel_envs import ParallelEnvs
from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.training.episodes import EpisodeMaker, Wrapping
from me3bev_cli.workers import cores

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe
    from me3bev_cli.recipe_stages import SimulatedStage


def make_environments(
    recipe: Recipe, stage: SimulatedStage, first_episode: int = 0, around: Wrapping | None = None
) -> VecEnv:
    """The stage's environments: in worker processes, or one after another in this one when there is one worker.

    What they play does not depend on the number of workers.

    Args:
        first_episode: index of the first episode to play: a run that goes on does not repeat what it has seen.
        around: wraps each environment, in the process in which it lives; can be pickled.
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
        )
        for index in range(stage.envs)
    ]
    workers = min(stage.envs, stage.workers or cores())
    return ParallelEnvs(makers, workers) if workers > 1 else DummyVecEnv(list(makers))
