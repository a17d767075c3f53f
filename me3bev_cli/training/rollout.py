"""Rollout storage of single frames, handed out as contiguous segments.

No observation is stacked: frame t of environment e is stored once. A minibatch is a set of segments of L frames,
each preceded by the P frames that a window needs (P = T - 1), so that every frame is encoded once and gradients equal
those of stacked observations. Of a frozen encoder the embeddings are stored, not what it read.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples
from stable_baselines3.common.vec_env import VecNormalize

from me3bev_cli.pipeline.network import embedding_key
from me3bev_cli.pipeline.policy import ROWS, STARTS, STATE
from me3bev_cli.pipeline.sensor import SOURCES
from me3bev_cli.pipeline.transfer import gather, to_device
from me3bev_cli.pipeline.tree import map_tree

Frames = dict[str, NDArray[Any]]


def stored_arrays(
    space: spaces.Dict, embeddings: Mapping[str, tuple[int, int]]
) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Shape and type of what is stored of one frame, by key.

    Args:
        space: of an observation, boxes by key.
        embeddings: (K, D) of the modalities whose embedding is stored in place of what it is made from.
    """
    replaced = {source for name in embeddings for source in SOURCES[name]}
    kept = {
        key: (tuple(part.shape or ()), np.dtype(part.dtype))
        for key, part in space.spaces.items()
        if key not in replaced
    }
    return kept | {embedding_key(name): (shape, np.dtype(np.float32)) for name, shape in embeddings.items()}


class SequenceRolloutBuffer(RolloutBuffer):
    """SB3's rollout buffer for dict observations and segments; GAE is SB3's own.

    Args:
        segment: L, frames per segment; must divide `buffer_size`.
        prefix: P, frames kept from the end of the rollout before.
        seed: of the order in which segments are handed out.
        embeddings: (K, D) of the modalities that are stored as embeddings.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_space: spaces.Dict,
        action_space: spaces.Space[Any],
        device: torch.device | str = "auto",
        gae_lambda: float = 1.0,
        gamma: float = 0.99,
        n_envs: int = 1,
        *,
        segment: int,
        prefix: int,
        seed: int = 0,
        embeddings: Mapping[str, tuple[int, int]] | None = None,
    ) -> None:
        self.segment, self.prefix = segment, prefix
        self.generator = np.random.default_rng(seed)
        # (P + buffer_size, n_envs, ...): allocated once; `reset` only moves the tail to the front.
        length = prefix + buffer_size
        self.frames: Frames = {
            key: np.zeros((length, n_envs, *shape), dtype)
            for key, (shape, dtype) in stored_arrays(observation_space, embeddings or {}).items()
        }
        self.starts = np.zeros((length, n_envs), np.bool_)
        self.states: list[Any] = []
        super().__init__(buffer_size, observation_space, action_space, device, gae_lambda, gamma, n_envs)

    def reset(self) -> None:
        """Begin a new rollout; the last P frames of the one before become its prefix."""
        shape = (self.buffer_size, self.n_envs)
        if self.full and self.prefix:
            for array in (*self.frames.values(), self.starts):
                array[: self.prefix] = array[-self.prefix :]
        self.actions = np.zeros((*shape, self.action_dim), np.float32)
        for name in ("rewards", "returns", "episode_starts", "values", "log_probs", "advantages"):
            setattr(self, name, np.zeros(shape, np.float32))
        self.states = []
        self.generator_ready = False
        self.pos, self.full = 0, False

    def forget_prefix(self) -> None:
        """Mark the prefix as another episode: after a break its frames are not what came before."""
        self.starts[: self.prefix] = True

    def add_state(self, state: Any) -> None:
        """Store the memory from which the segment starting at the current frame begins (context: stream)."""
        self.states.append(map_tree(lambda leaf: leaf.detach().clone(), state))

    def add(  # type: ignore[override]
        self,
        obs: Frames,
        action: NDArray[np.float32],
        reward: NDArray[np.float32],
        episode_start: NDArray[np.bool_],
        value: torch.Tensor,
        log_prob: torch.Tensor,
    ) -> None:
        """Store one step of every environment."""
        for key, array in self.frames.items():
            array[self.prefix + self.pos] = obs[key]
        self.starts[self.prefix + self.pos] = episode_start
        self.actions[self.pos] = action
        self.rewards[self.pos] = reward
        self.episode_starts[self.pos] = episode_start
        self.values[self.pos] = value.cpu().numpy()
        self.log_probs[self.pos] = log_prob.cpu().numpy()
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def get(self, batch_size: int | None = None) -> Generator[DictRolloutBufferSamples, None, None]:  # type: ignore[override]
        """Minibatches of about `batch_size` frames: whole segments in random order, each once."""
        first = np.arange(0, self.buffer_size, self.segment)
        pairs = np.stack(np.meshgrid(first, np.arange(self.n_envs), indexing="ij"), -1).reshape(-1, 2)
        order = self.generator.permutation(len(pairs))
        per_batch = max(1, (batch_size or self.buffer_size * self.n_envs) // self.segment)
        for low in range(0, len(order), per_batch):
            yield self._segments(pairs[order[low : low + per_batch]])

    def _segments(self, pairs: NDArray[np.int64]) -> DictRolloutBufferSamples:
        """Segments named by (first frame, environment) -> tensors."""
        first, env = pairs[:, :1], pairs[:, 1:]
        seen = first + np.arange(self.prefix + self.segment)
        own = first + np.arange(self.segment)
        starts = self.starts[seen, env]
        frames, rows = self._needed(seen * self.n_envs + env, starts)
        observations = {
            key: gather(array.reshape(-1, *array.shape[2:]), frames, self.device) for key, array in self.frames.items()
        }
        observations[STARTS] = self.to_torch(starts)
        if rows is not None:
            observations[ROWS] = self.to_torch(rows)
        if self.states:
            observations[STATE] = self._states(pairs)
        return DictRolloutBufferSamples(
            observations=observations,
            actions=self.to_torch(self.actions[own, env].reshape(-1, self.action_dim)),
            old_values=self.to_torch(self.values[own, env].ravel()),
            old_log_prob=self.to_torch(self.log_probs[own, env].ravel()),
            advantages=self.to_torch(self.advantages[own, env].ravel()),
            returns=self.to_torch(self.returns[own, env].ravel()),
        )

    def _needed(
        self, wanted: NDArray[np.int64], starts: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64] | None]:
        """Each frame that some decision depends on, once, and where it stands.

        Args:
            wanted: (B, P + L), a number for each stored frame.
            starts: (B, P + L).

        Returns:
            The numbers of N frames, and (B, P + L) places among them; None: N = B (P + L) in order.
        """
        if not self.prefix:
            return wanted.ravel(), None
        # A prefix frame before an episode's start is in no window: any frame may stand in its place.
        later = np.logical_or.accumulate(starts[:, self.prefix : 0 : -1], axis=1)[:, ::-1]
        before = np.where(later, wanted[:, self.prefix :][:, :1], wanted[:, : self.prefix])
        frames, rows = np.unique(np.concatenate([before, wanted[:, self.prefix :]], 1), return_inverse=True)
        return frames, rows.reshape(wanted.shape)

    def to_torch(self, array: NDArray[Any], copy: bool = True) -> torch.Tensor:
        """An array that nobody else holds, on the buffer's device."""
        return to_device(array, self.device)

    def _states(self, pairs: NDArray[np.int64]) -> Any:
        """The stored memory of each segment, batch first."""
        chosen = [(int(first) // self.segment, int(env)) for first, env in pairs]
        return map_tree(
            lambda *leaves: torch.stack([leaves[index][env] for index, env in chosen]), self.states[0], *self.states[1:]
        )

    def _get_samples(self, batch_inds: NDArray[Any], env: VecNormalize | None = None) -> Any:
        """Single transitions are not handed out: memory needs contiguous frames."""
        raise TypeError("this buffer hands out segments, not transitions")
