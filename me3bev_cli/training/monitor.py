"""Watches a stage while it runs: counts, logs, checkpoints and stops it when asked."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat

if TYPE_CHECKING:
    from me3bev_cli.recipe import PpoStage
    from me3bev_cli.training.loop import Trainer
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


class InterruptedTrainingError(Exception):
    """Training was asked to stop; its checkpoint has been written."""


class Monitor(BaseCallback):
    """Per update one line of `metrics.jsonl` (and TensorBoard); checkpoints every so many steps."""

    def __init__(self, trainer: Trainer, model: SequencePPO, stage: PpoStage) -> None:
        super().__init__()
        self.trainer, self.stage = trainer, stage
        self.rewards: list[float] = []
        self.episodes: deque[dict[str, float]] = deque(maxlen=100)
        self.saved_at = trainer.progress.stage_steps
        self.clock = time.monotonic()
        board: list[KVWriter] = [TensorBoardOutputFormat(str(trainer.run / "tensorboard"))]
        model.set_logger(Logger(str(trainer.run), board))

    def _on_step(self) -> bool:
        progress = self.trainer.progress
        progress.stage_steps += self.training_env.num_envs
        progress.total_steps += self.training_env.num_envs
        for info, reward, done in zip(self.locals["infos"], self.locals["rewards"], self.locals["dones"], strict=True):
            self.rewards.append(float(reward))
            if done:
                self.episodes.append(_episode(info))
                progress.episodes += 1
        self.trainer.display.step(self._line)
        return not self.trainer.stop.asked

    def _on_rollout_start(self) -> None:
        """Called before each rollout: the update of the one before is finished here."""
        progress = self.trainer.progress
        if progress.stage_steps - self.saved_at >= self.stage.checkpoint_every:
            self.saved_at = progress.stage_steps
            self.trainer.save(self.model)  # type: ignore[arg-type]

    def _on_rollout_end(self) -> None:
        progress = self.trainer.progress
        progress.updates += 1
        now = time.monotonic()
        row = self._line()
        row["steps_per_second"] = len(self.rewards) / (now - self.clock)
        self.clock = now
        values = self.model.logger.name_to_value
        row |= {name: float(values[key]) for key, name in LOSSES.items() if key in values}
        for key in ("reward_per_step", "collision_rate", "route_completion"):
            if row[key] is not None:
                self.model.logger.record(f"rollout/{key}", row[key])
        self.rewards.clear()
        with open(self.trainer.run / "metrics.jsonl", "a") as file:
            file.write(json.dumps({k: v if _finite(v) else None for k, v in row.items()}) + "\n")
        self.trainer.display.update(row)

    def _line(self) -> dict[str, Any]:
        """Where the run stands."""
        progress = self.trainer.progress
        means = {
            key: float(np.mean([episode[key] for episode in self.episodes])) if self.episodes else None
            for key in ("collision_rate", "route_completion", "episode_steps")
        }
        return {
            "stage": progress.stage,
            "steps": progress.total_steps,
            "stage_steps": progress.stage_steps,
            "episodes": progress.episodes,
            "reward_per_step": float(np.mean(self.rewards)) if self.rewards else None,
            **means,
        }


def _episode(info: dict[str, Any]) -> dict[str, float]:
    record = info["record"]
    return {
        "collision_rate": float(record["collision"] != ""),
        "route_completion": min(1.0, record["route_done"] / max(record["route_length"], 1e-6)),
        "episode_steps": float(info["episode"]["l"]),
    }


def _finite(value: Any) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
