"""The training environments of a stage: several episodes side by side, each with a seed of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from me3bev_cli.pipeline.assemble import configured
from me3bev_cli.seeding import derive_seed

if TYPE_CHECKING:
    from me3bev_cli.recipe import PpoStage, Recipe


class SeededEpisodes(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Seeds every episode from (run seed, map, density, episode index); environment k of n plays k, k + n, ..."""

    def __init__(self, env: gymnasium.Env[Any, Any], names: tuple[str | int, ...], first: int, stride: int) -> None:
        super().__init__(env)
        self.names = names
        self.next_index, self.stride = first, stride

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode; a seed that is passed in is not used."""
        episode_seed = derive_seed(*self.names, self.next_index)
        self.next_index += self.stride
        return self.env.reset(seed=episode_seed, options=options)


def make_environments(recipe: Recipe, stage: PpoStage, first_episode: int = 0) -> VecEnv:
    """The stage's environments in this process, stepped one after another.

    Args:
        first_episode: index of the first episode to play: a run that goes on does not repeat what it has seen.
    """
    choice = recipe.simulator_in(stage)
    cls, config = configured("simulator", choice)
    simulator = cls(config)
    place, density = choice.map, choice.density
    weather = recipe.weather_in(stage)
    names = (recipe.seed, place, density)

    def maker(index: int) -> Any:
        def make() -> gymnasium.Env[Any, Any]:
            images = "bev" in recipe.modalities
            env = simulator.make_env(recipe.observation, map=place, density=density, weather=weather, images=images)
            return Monitor(SeededEpisodes(env, names, first_episode + index, stage.envs))

        return make

    return DummyVecEnv([maker(index) for index in range(stage.envs)])
