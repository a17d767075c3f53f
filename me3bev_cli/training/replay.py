"""Environments that remember how they came to where they are, so that a run can go on from there exactly.

A world is not stored: its episode is begun again, with the same seed, and the same actions are taken. That works with
any simulator whose episodes follow from seed and actions, in any number of worker processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from me3bev_cli.environment_host import Play, play_again
from me3bev_cli.environment_workers import Recovery
from me3bev_cli.parallel_envs import ParallelEnvs

Observations = dict[str, NDArray[Any]]


class ReplayedEnvs(VecEnvWrapper):
    """Keeps, for each environment, the index of its episode and the actions taken in it.

    A worker process that dies or hangs is started again and its episodes are played again.

    Args:
        venv: environments whose outermost or an inner wrapper is `SeededEpisodes`.
        first: index of each environment's first episode.
        stride: from there to the next one.
        told: called with a sentence when a worker is started again.
        silence: seconds without an answer after which a worker is taken for hung; None: never.
        check: called a few times a second while a worker is silent; may raise to give up.
    """

    def __init__(
        self,
        venv: DummyVecEnv | ParallelEnvs,
        first: Sequence[int],
        stride: int,
        told: Callable[[str], None],
        silence: float | None = None,
        check: Callable[[], None] | None = None,
    ) -> None:
        super().__init__(venv)
        self.stride = stride
        self.episodes = list(first)
        """Index of the episode that each environment plays."""
        self._actions: list[list[NDArray[Any]] | None] = [None] * venv.num_envs
        self._asked: NDArray[Any] = np.zeros(0)
        if isinstance(venv, ParallelEnvs):
            venv.recover_with(Recovery(self.plays, told, silence, check))

    def plays(self) -> list[Play]:
        """Where each environment stands."""
        return [
            Play(episode, None if actions is None else tuple(actions))
            for episode, actions in zip(self.episodes, self._actions, strict=True)
        ]

    def reset(self) -> Any:
        """Begin the next episode in every environment."""
        observations = self.venv.reset()
        self.reset_infos = self.venv.reset_infos
        for index in range(self.num_envs):
            self._begin(index)
        return observations

    def _begin(self, index: int) -> None:
        if self._actions[index] is not None:
            self.episodes[index] += self.stride
        self._actions[index] = []

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """What a method of each environment returns; `play_from` is noted."""
        if method_name == "play_from":
            for index in self._get_indices(indices):
                self.episodes[index], self._actions[index] = args[0], None
        return self.venv.env_method(method_name, *args, indices=indices, **kwargs)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Begin a step."""
        self._asked = np.array(actions)
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Finish a step and note it."""
        result = self.venv.step_wait()
        self.reset_infos = self.venv.reset_infos
        for index, done in enumerate(result[2]):
            actions = self._actions[index]
            if done or actions is None:
                self._begin(index)
            else:
                actions.append(self._asked[index])
        return result

    def state(self) -> dict[str, Any]:
        """What `restore` needs: tensors and plain values, a copy."""
        shape = self.action_space.shape or ()
        return {
            "episodes": list(self.episodes),
            "actions": [
                None if taken is None else torch.from_numpy(np.array(taken).reshape(len(taken), *shape))
                for taken in self._actions
            ],
        }

    def restore(self, state: dict[str, Any], check: Callable[[], None] | None = None) -> Observations | None:
        """Bring every environment where `state` says; the observations there, None if no episode had begun.

        Args:
            check: called often while episodes are played again; may raise to give up.
        """
        self.episodes = list(state["episodes"])
        self._actions = [None if taken is None else list(taken.numpy()) for taken in state["actions"]]
        plays = self.plays()
        if isinstance(self.venv, ParallelEnvs):
            observations: Observations = self.venv.replay(plays, check)
        else:
            assert isinstance(self.venv, DummyVecEnv)
            for index, (env, play) in enumerate(zip(self.venv.envs, plays, strict=True)):
                observation = play_again(env, play, check)
                if observation is not None:
                    self.venv._save_obs(index, observation)
            observations = self.venv._obs_from_buf()  # type: ignore[assignment]
        return None if self._actions[0] is None else observations
