"""What a worker process of `ParallelEnvs` does. It needs neither torch nor Stable-Baselines3, and loads neither."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
from gymnasium import spaces
from numpy.typing import NDArray

from me3bev_cli.shared_observations import SharedObservations

Env = gymnasium.Env[Any, Any]
StepResults = tuple[list[float], list[bool], list[dict[str, Any]], dict[int, dict[str, Any]]]
"""Rewards, ends of episodes, infos, and what the reset of each environment that ended told, by its position here."""


@dataclass(frozen=True)
class Play:
    """Where an environment stands: from this a deterministic one can be brought there again, in any process."""

    episode: int
    """Index of the episode that it plays, or, before its first reset, of the one that it will play."""
    actions: Sequence[NDArray[Any]] | None
    """What has been done since the episode began; None: it has not begun."""


def play_again(env: Env, play: Play, check: Callable[[], None] | None = None) -> Any:
    """Bring an environment where `play` says; its observation there, or None before its first reset.

    Args:
        env: has a method `play_from(episode)`, in any wrapper, that chooses the episode of the next reset.
        check: called before each step; may raise to give up.
    """
    env.get_wrapper_attr("play_from")(play.episode)
    if play.actions is None:
        return None
    observation, _ = env.reset()
    for action in play.actions:
        if check is not None:
            check()
        observation, *_ = env.step(action)
    return observation


class EnvironmentHost:
    """Some environments, one after another; called with (name of a method, its arguments).

    Args:
        makers: make the environments; can be pickled.
    """

    def __init__(self, makers: Sequence[Callable[[], Env]]) -> None:
        self.makers = makers
        self.envs: list[Env] = []
        self.memory: SharedObservations | None = None

    def __call__(self, call: tuple[Any, ...]) -> Any:
        """Do what the parent asks for."""
        name, *arguments = call
        return getattr(self, name)(*arguments)

    def open(self) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
        """Make the environments; the spaces of an observation and of an action."""
        self.envs = [make() for make in self.makers]
        return self.envs[0].observation_space, self.envs[0].action_space

    def attach(self, name: str) -> None:
        """Write observations into the shared memory of that name."""
        assert isinstance(self.envs[0].observation_space, spaces.Dict)
        self.memory = SharedObservations(self.envs[0].observation_space, len(self.envs), name)

    def replay(self, plays: Sequence[Play]) -> None:
        """Bring every environment where its play says."""
        assert self.memory is not None
        for i, (env, play) in enumerate(zip(self.envs, plays, strict=True)):
            observation = play_again(env, play)
            if observation is not None:
                self.memory.write(self.memory.newest, i, observation)

    def reset(self, seeds: Sequence[int | None], options: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """Begin an episode in every environment; what the resets told."""
        assert self.memory is not None
        told = []
        for i, (env, seed, given) in enumerate(zip(self.envs, seeds, options, strict=True)):
            observation, info = env.reset(seed=seed, options=given) if given else env.reset(seed=seed)
            self.memory.write(self.memory.newest, i, observation)
            told.append(info)
        return told

    def step(self, actions: NDArray[Any]) -> StepResults:
        """Step every environment. Where an episode ends the next one begins; its last observation is kept too."""
        assert self.memory is not None
        results: StepResults = [], [], [], {}
        rewards, dones, infos, resets = results
        for i, (env, action) in enumerate(zip(self.envs, actions, strict=True)):
            observation, reward, terminated, truncated, info = env.step(action)
            info["TimeLimit.truncated"] = truncated and not terminated
            if terminated or truncated:
                self.memory.write(self.memory.last, i, observation)
                observation, resets[i] = env.reset()
            self.memory.write(self.memory.newest, i, observation)
            rewards.append(float(reward))
            dones.append(bool(terminated or truncated))
            infos.append(info)
        return results

    def has_attr(self, positions: Sequence[int], name: str) -> list[bool]:
        """Whether some environments have an attribute, in any wrapper."""
        return [self.envs[i].has_wrapper_attr(name) for i in positions]

    def get_attr(self, positions: Sequence[int], name: str) -> list[Any]:
        """An attribute of some environments, whichever wrapper has it."""
        return [self.envs[i].get_wrapper_attr(name) for i in positions]

    def set_attr(self, positions: Sequence[int], name: str, value: Any) -> list[None]:
        """Set an attribute of some environments' outermost wrappers."""
        for i in positions:
            setattr(self.envs[i], name, value)
        return [None for _ in positions]

    def env_method(self, positions: Sequence[int], name: str, args: Sequence[Any], kwargs: dict[str, Any]) -> list[Any]:
        """Call a method of some environments, whichever wrapper has it."""
        return [self.envs[i].get_wrapper_attr(name)(*args, **kwargs) for i in positions]

    def is_wrapped(self, positions: Sequence[int], wrapper: type[Any]) -> list[bool]:
        """Whether a wrapper of some class is around each of some environments."""
        found = []
        for i in positions:
            env = self.envs[i]
            while isinstance(env, gymnasium.Wrapper) and not isinstance(env, wrapper):
                env = env.env
            found.append(isinstance(env, wrapper))
        return found

    def close(self) -> None:
        """Close the environments and let go of the memory."""
        for env in self.envs:
            env.close()
        if self.memory is not None:
            self.memory.close()
