"""What an autopilot would have done in the states that were visited: told by the environment, kept in a pool of rounds.

The environment's side imports no torch: worker processes load this module with their environments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

LABEL = "autopilot"
"""Key of an observation that holds the autopilot's action (2,) in the state that was reached."""

Floats = NDArray[np.float32]
Arrays = dict[str, NDArray[Any]]


class Taught(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Tells in each observation what the simulator's autopilot would do next."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        assert isinstance(env.observation_space, spaces.Dict)
        self.observation_space = spaces.Dict({**env.observation_space, LABEL: spaces.Box(-1.0, 1.0, (2,), np.float32)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        return {**observation, LABEL: self._label()}, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """One step of the environment."""
        observation, *rest = self.env.step(action)
        return {**observation, LABEL: self._label()}, *rest  # type: ignore[return-value]

    def _label(self) -> Floats:
        return np.clip(np.asarray(self.env.unwrapped.autopilot(), np.float32), -1.0, 1.0)  # type: ignore[attr-defined]


@dataclass
class Round:
    """T frames of each of n environments, from the begin of an episode in each; observations are stored once.

    Args:
        index: of the round.
        first: index of the first environment's first episode.
        length: T.
        envs: n.
        prefix: P, rows kept free before the first frame, marked as another episode: a segment may look back to them.
    """

    index: int
    first: int
    length: int
    envs: int
    prefix: int
    frames: Arrays = field(init=False, default_factory=dict)
    """(P + T, n, ...)"""

    def __post_init__(self) -> None:
        shape = (self.length, self.envs)
        self.starts = np.ones((self.prefix + self.length, self.envs), np.bool_)
        self.labels = np.zeros((*shape, 2), np.float32)
        self.actions = np.zeros((*shape, 2), np.float32)
        """As applied: with them the round can be played again."""
        self.guided = np.zeros(shape, np.bool_)
        """Where the autopilot drove."""
        self.rewards = np.zeros(shape, np.float32)
        """As learned from, not scaled."""
        self.ended = np.zeros(shape, np.bool_)
        """The episode ended with this step, for good."""
        self.cut = np.zeros(shape, np.bool_)
        """It ended, but only for want of time."""
        self.returns = np.zeros(shape, np.float32)

    @property
    def size(self) -> int:
        """Frames."""
        return self.length * self.envs

    def observe(self, row: int, observation: Mapping[str, NDArray[Any]], starts: NDArray[np.bool_]) -> None:
        """Keep the frames of one step, as they are stored: images, or what a fixed encoder made of them."""
        if not self.frames:
            total = self.prefix + self.length
            self.frames = {key: np.zeros((total, *value.shape), value.dtype) for key, value in observation.items()}
        for key, array in self.frames.items():
            array[self.prefix + row] = observation[key]
        self.starts[self.prefix + row] = starts

    def finish(self, gamma: float, scale: float) -> None:
        """Work out the discounted returns of the scaled rewards.

        What is cut off, by a time limit or by the end of the round, is taken to go on with the round's mean reward.
        """
        rewards = scale * self.rewards
        beyond = np.float32(rewards.mean() / (1.0 - gamma))
        following = np.full(self.envs, beyond, np.float32)
        for row in reversed(range(self.length)):
            following = np.where(self.ended[row], np.float32(0.0), np.where(self.cut[row], beyond, following))
            following = self.returns[row] = rewards[row] + np.float32(gamma) * following


@dataclass(frozen=True)
class Lesson:
    """B segments of L frames with P before each, flattened."""

    observations: Arrays
    """(B (P + L), ...)"""
    starts: NDArray[np.bool_]
    """(B, P + L)"""
    labels: Floats
    """(B L, 2)"""
    returns: Floats
    """(B L,)"""


class Pool:
    """The newest rounds, handed out as contiguous segments.

    Args:
        capacity: frames; the oldest rounds go when there are more.
        segment: L.
        prefix: P of the rounds.
    """

    def __init__(self, capacity: int, segment: int, prefix: int) -> None:
        self.capacity, self.segment, self.prefix = capacity, segment, prefix
        self.rounds: list[Round] = []

    def make_room(self, frames: int) -> None:
        """Let the oldest rounds go until so many frames more can be kept."""
        while self.rounds and sum(one.size for one in self.rounds) + frames > self.capacity:
            self.rounds.pop(0)

    def add(self, one: Round) -> None:
        """Keep a finished round."""
        self.make_room(one.size)
        self.rounds.append(one)

    def segments(self) -> NDArray[np.int64]:
        """Every segment as (round, first frame, environment), (S, 3)."""
        grids = [
            np.stack(np.meshgrid([k], np.arange(0, one.length, self.segment), np.arange(one.envs), indexing="ij"), -1)
            for k, one in enumerate(self.rounds)
        ]
        return np.concatenate([grid.reshape(-1, 3) for grid in grids])

    def order(self, rng: np.random.Generator, batches: int, per_batch: int) -> NDArray[np.int64]:
        """Segments for so many minibatches, (batches, per_batch, 3): all in random order, again and again."""
        every = self.segments()
        need = batches * per_batch
        passes = [rng.permutation(every) for _ in range(-(-need // len(every)))]
        return np.concatenate(passes)[:need].reshape(batches, per_batch, 3)

    def lesson(self, segments: NDArray[np.int64]) -> Lesson:
        """What is in some segments (B, 3)."""
        keys = self.rounds[0].frames
        parts = [(self.rounds[k], slice(t, t + self.prefix + self.segment), env) for k, t, env in segments.tolist()]
        own = [(self.rounds[k], slice(t, t + self.segment), env) for k, t, env in segments.tolist()]
        return Lesson(
            {key: np.concatenate([one.frames[key][rows, env] for one, rows, env in parts]) for key in keys},
            np.stack([one.starts[rows, env] for one, rows, env in parts]),
            np.concatenate([one.labels[rows, env] for one, rows, env in own]),
            np.concatenate([one.returns[rows, env] for one, rows, env in own]),
        )


def drifting_noise(
    rng: np.random.Generator, steps: int, envs: int, deviations: Sequence[float], keep: float = 0.9
) -> Floats:
    """Noise (steps, envs, 2) that lasts for about a second, so that a disturbed car really leaves its way.

    Args:
        deviations: of the two actions.
        keep: share of the noise that the next step keeps.
    """
    white = rng.standard_normal((steps, envs, 2)).astype(np.float32)
    noise = np.empty_like(white)
    noise[0] = white[0]
    for step in range(1, steps):
        noise[step] = np.float32(keep) * noise[step - 1] + np.float32(np.sqrt(1 - keep**2)) * white[step]
    return noise * np.asarray(deviations, np.float32)
