"""The episodes that a training environment plays. No torch here: worker processes make their environments with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
from gymnasium.wrappers import RecordEpisodeStatistics

from me3bev_cli.api import ObservationConfig
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.shaped_reward import ShapedReward


class SeededEpisodes(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Seeds every episode from (run seed, map, density, episode index); environment k of n plays k, k + n, ..."""

    def __init__(self, env: gymnasium.Env[Any, Any], names: tuple[str | int, ...], first: int, stride: int) -> None:
        super().__init__(env)
        self.names = names
        self.next_index, self.stride = first, stride

    def play_from(self, episode: int) -> None:
        """Choose the episode of the next reset."""
        self.next_index = episode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the next episode; a seed that is passed in is not used."""
        episode_seed = derive_seed(*self.names, self.next_index)
        self.next_index += self.stride
        return self.env.reset(seed=episode_seed, options=options)


Wrapping = Callable[[gymnasium.Env[Any, Any]], gymnasium.Env[Any, Any]]


@dataclass(frozen=True)
class EpisodeMaker:
    """Makes one of a stage's environments, here or in a worker process.

    Its infos hold, where an episode ends, `episode`: its return, its length in steps and its seconds, as r, l and t.
    """

    simulator: Any
    """An instance of a `SimulatorPlugin`."""
    observation: ObservationConfig
    map: str
    density: str
    weather: tuple[str, ...] | None
    images: bool
    run_seed: int
    first: int
    """Index of the first episode."""
    stride: int
    """From there to the next one."""
    around: Wrapping | None = None
    """Wraps the environment once more."""
    terms: Mapping[str, float] = field(default_factory=dict)
    """Weights of the terms that are added to the reward."""

    def __call__(self) -> gymnasium.Env[Any, Any]:
        env = self.simulator.make_env(
            self.observation, map=self.map, density=self.density, weather=self.weather, images=self.images
        )
        seeded = SeededEpisodes(env, (self.run_seed, self.map, self.density), self.first, self.stride)
        recorded: gymnasium.Env[Any, Any] = RecordEpisodeStatistics(seeded)
        if self.terms:
            recorded = ShapedReward(recorded, self.terms)
        return self.around(recorded) if self.around is not None else recorded
