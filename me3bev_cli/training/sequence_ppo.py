"""SB3's PPO on sequences. Loss, GAE, schedules, logger and callbacks are SB3's; what is ours is memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from me3bev_cli.pipeline.control import to_tensors
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.policy import DrivingPolicy
from me3bev_cli.pipeline.tree import map_tree
from me3bev_cli.training.rollout import SequenceRolloutBuffer


class SequencePPO(PPO):
    """PPO whose policy remembers: state is carried while collecting and cleared at episode starts."""

    rollout_buffer: SequenceRolloutBuffer
    policy: DrivingPolicy  # type: ignore[assignment]

    def __init__(self, *args: Any, reward_scale: float = 1.0, **kwargs: Any) -> None:
        self.reward_scale = reward_scale
        self._state: Any = None
        super().__init__(*args, **kwargs)

    @property
    def network(self) -> Network:
        """The network that is trained."""
        return self.policy.network

    def _setup_learn(self, *args: Any, **kwargs: Any) -> tuple[int, BaseCallback]:
        result = super()._setup_learn(*args, **kwargs)
        assert self.env is not None
        self._state = self.network.initial_state(self.env.num_envs)
        self.rollout_buffer.forget_prefix()
        return result

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: RolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Fill the buffer with `n_rollout_steps` frames of every environment; False if a callback stopped it."""
        assert isinstance(rollout_buffer, SequenceRolloutBuffer)
        assert isinstance(env.action_space, spaces.Box)
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        low, high = env.action_space.low, env.action_space.high
        dones = np.zeros(env.num_envs, bool)
        for step in range(n_rollout_steps):
            if self._streams and step % rollout_buffer.segment == 0:
                rollout_buffer.add_state(self._state)
            observation, starts = self._last_obs, np.asarray(self._last_episode_starts, bool)
            actions, values, log_probs = self._choose(observation, starts)
            new_obs, rewards, dones, infos = env.step(np.clip(actions, low, high))
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            targets = self._bootstrap(rewards * self.reward_scale, dones, infos)
            rollout_buffer.add(observation, actions, targets, starts, values, log_probs)  # type: ignore[arg-type]
            self._last_obs, self._last_episode_starts = new_obs, dones  # type: ignore[assignment]
        last_values = self._value(self._last_obs, self._state, dones)
        rollout_buffer.compute_returns_and_advantage(last_values=last_values, dones=dones)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    @property
    def _streams(self) -> bool:
        """Whether segments start from a stored state (context: stream) rather than from a prefix of frames."""
        return bool(self._state) and self.network.prefix == 0

    @torch.no_grad()
    def _choose(self, observation: Any, starts: NDArray[np.bool_]) -> tuple[Any, torch.Tensor, torch.Tensor]:
        """Sample an action in each environment and advance the memory."""
        frames = to_tensors(observation, self.device)
        decision, self._state = self.network.step(frames, self._state, torch.as_tensor(starts).to(self.device))
        actions = decision.actions.sample()
        return actions.cpu().numpy(), decision.values, decision.actions.log_prob(actions)

    @torch.no_grad()
    def _value(self, observation: Any, state: Any, starts: NDArray[np.bool_]) -> torch.Tensor:
        """The value of the next frames, without advancing the memory."""
        decision, _ = self.network.step(
            to_tensors(observation, self.device), state, torch.as_tensor(starts).to(self.device)
        )
        return decision.values

    def _bootstrap(
        self, rewards: NDArray[np.floating[Any]], dones: NDArray[np.bool_], infos: list[dict[str, Any]]
    ) -> NDArray[np.floating[Any]]:
        """Add the discounted value of the state that a time limit cut off."""
        cut = [i for i, done in enumerate(dones) if done and infos[i].get("TimeLimit.truncated", False)]
        if not cut:
            return rewards
        last = [infos[i]["terminal_observation"] for i in cut]
        observation = {key: np.stack([obs[key] for obs in last]) for key in last[0]}
        rows = torch.as_tensor(cut, device=self.device)
        state = map_tree(lambda leaf: leaf[rows], self._state)
        values = self._value(observation, state, np.zeros(len(cut), bool))
        rewards = rewards.copy()
        rewards[cut] += self.gamma * values.cpu().numpy()
        return rewards
