"""Watches a `ppo` stage while it runs: counts, logs, checkpoints and stops it when asked."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from me3bev_cli.training.alarms import Watch, check_losses, check_rewards
from me3bev_cli.training.guidance import AutopilotGuide
from me3bev_cli.training.ppo_state import capture, take_up
from me3bev_cli.training.shaped_reward import PLAIN
from me3bev_cli.training.trainer import InterruptedTrainingError

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import PpoStage
    from me3bev_cli.training.replay import ReplayedEnvs
    from me3bev_cli.training.sequence_ppo import SequencePPO
    from me3bev_cli.training.trainer import Trainer

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
    """Per update one row of the log; at each boundary between updates what a checkpoint needs is kept in memory.

    Args:
        state: of the checkpoint that the run goes on from, if any.
    """

    model: SequencePPO

    def __init__(self, trainer: Trainer, stage: PpoStage, env: ReplayedEnvs, state: dict[str, Any] | None) -> None:
        super().__init__()
        self.trainer, self.stage, self.env = trainer, stage, env
        self.rewards: list[float] = []
        self.shaped: list[float] | None = [] if trainer.recipe.reward_in(stage) else None
        self.episodes: deque[dict[str, float]] = deque(maxlen=100)
        self.watch = Watch(stage.alarms, stage.target_kl, trainer.run, trainer.warn)
        self.saved_at = trainer.progress.stage_steps
        self.clock = time.monotonic()
        self._state = state

    def _on_training_start(self) -> None:
        """`learn` has emptied what it needs: fill it as it was."""
        if self._state is not None:
            self.episodes.extend(self._state["monitor"]["episodes"])
            self.watch.restore(self._state["monitor"]["watch"])
            take_up(self.model, self._state)

    def _on_step(self) -> bool:
        infos, rewards, dones = (self.locals[key] for key in ("infos", "rewards", "dones"))
        check_rewards(rewards, self.env.episodes)
        # The log shows the simulator's own reward, whatever the recipe adds to it.
        self.rewards.extend(float(info.get(PLAIN, reward)) for info, reward in zip(infos, rewards, strict=True))
        if self.shaped is not None:
            self.shaped.extend(float(reward) for reward in rewards)
        self.episodes.extend(_episode(info) for info, done in zip(infos, dones, strict=True) if done)
        self.trainer.count(len(rewards), int(np.sum(dones)))
        self.trainer.display.step(lambda: self.trainer.standing() | self._means())
        self._check_stop()
        return True

    def _check_stop(self) -> None:
        if self.trainer.stopping:
            raise InterruptedTrainingError

    def _on_rollout_start(self) -> None:
        """Called before each rollout: the update of the one before is finished here."""
        self._tell()
        progress = self.trainer.progress
        self.trainer.mark(self._capture(), saved=self._state is not None)
        self._state = None
        if progress.stage_steps - self.saved_at >= self.stage.checkpoint_every:
            self.saved_at = progress.stage_steps
            self.trainer.save_mark()
        self._check_stop()
        begun = time.monotonic()
        self.trainer.evaluations.when_due()
        # The rate is that of training.
        self.clock += time.monotonic() - begun

    def _on_training_end(self) -> None:
        self._tell()

    def _capture(self) -> dict[str, Any]:
        monitor = {"episodes": list(self.episodes), "watch": self.watch.state()}
        return capture(self.model, self.env) | {"monitor": monitor}

    def _tell(self) -> None:
        """One row: the rollout and the update that learned from it, if there has been one."""
        if not self.rewards:
            return
        self.trainer.progress.updates += 1
        now = time.monotonic()
        row = self._means()
        row["steps_per_second"] = len(self.rewards) / (now - self.clock)
        self.clock = now
        values = self.model.logger.name_to_value
        row |= {name: float(values[key]) for key, name in LOSSES.items() if key in values}
        if isinstance(guide := self.model.policy.guide, AutopilotGuide):
            row["guidance_loss"] = guide.told()
        if self.shaped is not None:
            row["shaped_reward_per_step"] = float(np.mean(self.shaped))
            self.shaped.clear()
        self.rewards.clear()
        self.trainer.log(row)
        check_losses(values, self.trainer.run)
        entropy = row.get("entropy_loss")
        self.watch.update(row.get("kl"), None if entropy is None else -entropy)

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
