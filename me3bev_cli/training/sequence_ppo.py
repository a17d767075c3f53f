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

from me3bev_cli.pipeline.network import Network, embedding_key
from me3bev_cli.pipeline.policy import DrivingPolicy, settled_embeddings
from me3bev_cli.pipeline.transfer import to_device, to_tensors
from me3bev_cli.pipeline.tree import map_tree
from me3bev_cli.training.rollout import Frames, SequenceRolloutBuffer


class SequencePPO(PPO):
    """PPO whose policy remembers: state is carried while collecting and cleared at episode starts.

    Args:
        reward_scale: applied to the rewards that are learned from.
        store_embeddings: where an encoder is frozen, keep what it gave while collecting instead of what it read.
    """

    rollout_buffer: SequenceRolloutBuffer
    policy: DrivingPolicy  # type: ignore[assignment]

    def __init__(self, *args: Any, reward_scale: float = 1.0, store_embeddings: bool = True, **kwargs: Any) -> None:
        self.reward_scale = reward_scale
        self.store_embeddings = store_embeddings
        self._state: Any = None
        self._settled: tuple[str, ...] = ()
        super().__init__(*args, **kwargs)

    def _setup_model(self) -> None:
        if self.store_embeddings:
            settled = settled_embeddings(self.policy_kwargs["network"], self.policy_kwargs.get("frozen", ()))
            self._settled = tuple(settled)
            self.rollout_buffer_kwargs = {**self.rollout_buffer_kwargs, "embeddings": settled}
        super()._setup_model()

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
            actions, values, log_probs, embeddings = self._choose(observation, starts)
            new_obs, rewards, dones, infos = env.step(np.clip(actions, low, high))
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            targets = self._bootstrap(rewards * self.reward_scale, dones, infos)
            seen = {**observation, **embeddings}  # type: ignore[dict-item]
            rollout_buffer.add(seen, actions, targets, starts, values, log_probs)
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
    def _choose(
        self, observation: Any, starts: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float32], torch.Tensor, torch.Tensor, Frames]:
        """Sample an action in each environment and advance the memory.

        Returns:
            Actions (N, 2), values (N,), their log-probabilities (N,), and the embeddings that no update changes.
        """
        with self.policy.computing():
            embeddings = self.network.encode(to_tensors(observation, self.device))
            decision, self._state = self.network.advance(embeddings, self._state, to_device(starts, self.device))
        actions = decision.actions.sample()
        told = [actions, decision.values[:, None], decision.actions.log_prob(actions)[:, None]]
        # One copy: on a GPU each would wait for all that went before.
        chosen, values, log_probs = torch.split(torch.cat(told, 1).cpu(), [actions.shape[1], 1, 1], 1)
        settled = {embedding_key(name): embeddings[name].float().cpu().numpy() for name in self._settled}
        return chosen.numpy(), values[:, 0], log_probs[:, 0], settled

    @torch.no_grad()
    def _value(self, observation: Any, state: Any, starts: NDArray[np.bool_]) -> torch.Tensor:
        """The value of the next frames, without advancing the memory."""
        with self.policy.computing():
            frames = to_tensors(observation, self.device)
            return self.network.step(frames, state, to_device(starts, self.device))[0].values

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
