"""Plain Stable-Baselines3 PPO for a network with a window: every observation holds its last T frames.

SB3's own algorithm, rollout buffer, shuffling of single transitions and loss; the network and its weights are the
same as ours. What differs is that each of the T frames of each sample is stored and encoded for itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from torch import Tensor

from me3bev_cli.pipeline.network import Decision, Network
from me3bev_cli.pipeline.policy import PARTS, STARTS, Precision, computing

Stacks = dict[str, NDArray[Any]]


class StackedFrames(VecEnvWrapper):
    """Each observation (...) becomes the last T of its episode (T, ...), zeros before its first.

    `episode_starts` (T,) says where among them an episode begins.
    """

    def __init__(self, venv: VecEnv, length: int) -> None:
        assert isinstance(venv.observation_space, spaces.Dict)
        self.length = length
        boxes: dict[str, spaces.Space[Any]] = {
            key: _stacked(box, length) for key, box in venv.observation_space.spaces.items()
        }
        boxes[STARTS] = spaces.Box(0, 1, (length,), np.uint8)
        super().__init__(venv, spaces.Dict(boxes))
        self._stacks: Stacks = {}

    def reset(self) -> Stacks:
        """The first frames."""
        space = self.observation_space
        assert isinstance(space, spaces.Dict)
        self._stacks = {
            key: np.zeros((self.num_envs, *(box.shape or ())), box.dtype) for key, box in space.spaces.items()
        }
        self._push(self.venv.reset(), np.ones(self.num_envs, bool))  # type: ignore[arg-type]
        return {key: stack.copy() for key, stack in self._stacks.items()}

    def step_wait(self) -> Any:
        """As the environments', stacked; so are the last observations of episodes."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            last = infos[i]["terminal_observation"] | {STARTS: 0}
            infos[i]["terminal_observation"] = {
                key: np.concatenate([stack[i, 1:], np.asarray(last[key])[None]]).astype(stack.dtype)
                for key, stack in self._stacks.items()
            }
        self._push(observations, dones)  # type: ignore[arg-type]
        return {key: stack.copy() for key, stack in self._stacks.items()}, rewards, dones, infos

    def _push(self, observations: Stacks, starts: NDArray[np.bool_]) -> None:
        for key, stack in self._stacks.items():
            stack[starts] = 0
            stack[:, :-1] = stack[:, 1:]
            stack[:, -1] = starts if key == STARTS else observations[key]


def _stacked(box: spaces.Space[Any], length: int) -> spaces.Box:
    assert isinstance(box, spaces.Box)
    return spaces.Box(np.stack([box.low] * length), np.stack([box.high] * length), dtype=box.dtype.type)


class StackedPolicy(BasePolicy):
    """The network as SB3 wants a policy: without memory, the T frames of a sample are all it knows."""

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        use_sde: bool = False,
        *,
        network: Network,
        frozen: tuple[str, ...] = (),
        microbatch: int | None = None,
        autocast: Precision | None = None,
    ) -> None:
        super().__init__(observation_space, action_space, squash_output=False, normalize_images=False)
        self.network = network
        network.freeze(getattr(network, name) for part in frozen for name in PARTS[part])
        network.microbatch = microbatch
        self.autocast = autocast
        trained = [p for p in network.parameters() if p.requires_grad]
        self.optimizer = torch.optim.Adam(trained, lr=lr_schedule(1), eps=1e-5)

    def _decide(self, obs: Any) -> Decision:
        """Stacks (B, T, ...) -> decisions of their last frames."""
        frames = {key: value.flatten(0, 1) for key, value in obs.items() if key != STARTS}
        with computing(self.network.device, self.autocast):
            return self.network.evaluate(frames, {}, obs[STARTS].bool())

    def forward(self, obs: Any, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions (B, 2), values (B,) and log-probabilities (B,): SB3 calls this while collecting."""
        decision = self._decide(obs)
        actions = decision.actions.mode() if deterministic else decision.actions.sample()
        return actions, decision.values, decision.actions.log_prob(actions)

    def evaluate_actions(self, obs: Any, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-probabilities and entropies (B,): SB3 calls this in the update."""
        decision = self._decide(obs)
        return decision.values, decision.actions.log_prob(actions), decision.actions.entropy()

    def predict_values(self, obs: Any) -> Tensor:
        """Values (B,)."""
        return self._decide(obs).values

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        return self.forward(observation, deterministic)[0]
