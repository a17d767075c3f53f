"""The reward that is learned from where a recipe adds terms to the simulator's. No torch here: workers use it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium

from me3bev_cli.api import StepRecord
from me3bev_cli.reward_terms import bonus

PLAIN = "plain_reward"
"""Where a shaped step's info holds the simulator's own reward."""


class ShapedReward(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds weighted terms to the reward of each step; the info keeps the simulator's own as `PLAIN`.

    Args:
        env: its infos hold a `StepRecord` as `record`.
        weights: of some of `reward_terms.TERMS`.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], weights: Mapping[str, float]) -> None:
        super().__init__(env)
        self.weights = dict(weights)
        self._before: StepRecord | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._before = None
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """A step with the shaped reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        shaped = float(reward) + bonus(self.weights, self._before, info["record"])
        # A simulator may fill the same record again.
        self._before = info["record"].copy()
        return observation, shaped, terminated, truncated, {**info, PLAIN: float(reward)}
