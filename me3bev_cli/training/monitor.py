"""Watches a `ppo` stage while it runs: counts, logs, checkpoints and stops it when asked."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger

from me3bev_cli.training.shaped_reward import PLAIN

if TYPE_CHECKING:
    from me3bev_cli.training.ppo_stage import PpoRunner
    from me3bev_cli.training.sequence_ppo import SequencePPO

LOSSES = {
    "train/approx_kl": "kl",
    "train/entropy_loss": "entropy_loss",
    "train/value_loss": "value_loss",
    "train/policy_gradient_loss": "policy_loss",
    "train/clip_fraction": "clip_fraction",
    "train/explained_variance": "explained_variance",
    "train/learning_rate": "learning_rate",
}


class Monitor(BaseCallback):
    """Per update one row of the log; checkpoints every so many steps."""

    def __init__(self, runner: PpoRunner, model: SequencePPO) -> None:
        super().__init__()
        self.runner, self.trainer, self.stage = runner, runner.trainer, runner.stage
        self.rewards: list[float] = []
        self.shaped: list[float] | None = [] if self.trainer.recipe.reward_in(self.stage) else None
        self.episodes: deque[dict[str, float]] = deque(maxlen=100)
        self.saved_at = self.trainer.progress.stage_steps
        self.clock = time.monotonic()
        # The trainer writes the log; SB3's keeps the losses for it.
        model.set_logger(Logger(None, []))

    def _on_step(self) -> bool:
        infos, rewards, dones = (self.locals[key] for key in ("infos", "rewards", "dones"))
        # The log shows the simulator's own reward, whatever the recipe adds to it.
        self.rewards.extend(float(info.get(PLAIN, reward)) for info, reward in zip(infos, rewards, strict=True))
        if self.shaped is not None:
            self.shaped.extend(float(reward) for reward in rewards)
        self.episodes.extend(_episode(info) for info, done in zip(infos, dones, strict=True) if done)
        self.trainer.count(len(rewards), int(np.sum(dones)))
        self.trainer.display.step(lambda: self.trainer.standing() | self._means())
        return not self.trainer.stopping

    def _on_rollout_start(self) -> None:
        """Called before each rollout: the update of the one before is finished here."""
        progress = self.trainer.progress
        if progress.stage_steps - self.saved_at >= self.stage.checkpoint_every:
            self.saved_at = progress.stage_steps
            self.runner.save(self.model)  # type: ignore[arg-type]

    def _on_rollout_end(self) -> None:
        self.trainer.progress.updates += 1
        now = time.monotonic()
        row = self._means()
        row["steps_per_second"] = len(self.rewards) / (now - self.clock)
        self.clock = now
        values = self.model.logger.name_to_value
        row |= {name: float(values[key]) for key, name in LOSSES.items() if key in values}
        if self.shaped is not None:
            row["shaped_reward_per_step"] = float(np.mean(self.shaped))
            self.shaped.clear()
        self.rewards.clear()
        self.trainer.log(row)

    def _means(self) -> dict[str, float | None]:
        """Over the present rollout and over the last hundred episodes."""
        means = {
            key: float(np.mean([episode[key] for episode in self.episodes])) if self.episodes else None
            for key in ("collision_rate", "route_completion", "episode_steps")
        }
        return {"reward_per_step": float(np.mean(self.rewards)) if self.rewards else None, **means}


def _episode(info: dict[str, Any]) -> dict[str, float]:
    record = info["record"]
    return {
        "collision_rate": float(record["collision"] != ""),
        "route_completion": min(1.0, record["route_done"] / max(record["route_length"], 1e-6)),
        "episode_steps": float(info["episode"]["l"]),
    }
