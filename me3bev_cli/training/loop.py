"""Runs a recipe's stages in order, from the start or from a checkpoint, and leaves a run folder behind."""

from __future__ import annotations

import json
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from me3bev_cli.files import atomic_write_text
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.network import Network
from me3bev_cli.pipeline.policy import DrivingPolicy
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.checkpoint import (
    Progress,
    checkpoints,
    load_progress,
    load_trainer,
    load_weights,
    prune,
    save_checkpoint,
)
from me3bev_cli.training.curve import draw_curve, read_metrics
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.monitor import InterruptedTrainingError, Monitor
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.run import versions
from me3bev_cli.training.sequence_ppo import SequencePPO

if TYPE_CHECKING:
    from me3bev_cli.recipe import PpoStage, Recipe
    from me3bev_cli.stopping import Stop
    from me3bev_cli.training.display import Display

KEEP = 5
"""Checkpoints kept in a run."""


class Trainer:
    """One run: holds the network, walks the stages and writes checkpoints."""

    def __init__(self, recipe: Recipe, run: Path, display: Display, stop: Stop) -> None:
        self.recipe, self.run, self.display, self.stop = recipe, run, display, stop
        self.device = pick_device(recipe.device)
        self.network: Network = build_network(recipe, recipe.seed).to(self.device)
        self.progress = Progress()
        self._trainer_state: dict[str, Any] | None = None
        self._sitting = time.monotonic()

    def resume(self) -> None:
        """Take up the newest checkpoint of the run, if there is one.

        Raises:
            CheckpointError: it is damaged or of another architecture.
        """
        found = checkpoints(self.run)
        if found:
            load_weights(self.network, found[-1])
            self.progress = load_progress(found[-1])
            self._trainer_state = load_trainer(found[-1])
        self._forget_later_rows()

    def _forget_later_rows(self) -> None:
        """Drop what the log holds beyond the checkpoint: those updates were lost and are made again."""
        rows = [row for row in read_metrics(self.run) if row["steps"] <= self.progress.total_steps]
        atomic_write_text(self.run / "metrics.jsonl", "".join(json.dumps(row) + "\n" for row in rows))

    def train(self) -> Path:
        """Train until every stage is done; returns the last checkpoint.

        Raises:
            InterruptedTrainingError: Ctrl-C was pressed; a checkpoint has been written.
        """
        atomic_write_text(self.run / "versions.json", json.dumps(versions(), indent=1))
        while self.progress.stage < len(self.recipe.stages):
            self._ppo(self.recipe.stages[self.progress.stage])
            self.progress.stage += 1
            self.progress.stage_steps = self.progress.episodes = self.progress.updates = 0
            self._trainer_state = None
        self.progress.done = True
        last = self._save({})
        self._finish(last)
        return last

    def _ppo(self, stage: PpoStage) -> None:
        """One PPO stage, from where it stands to its last step."""
        env = make_environments(self.recipe, stage, self.progress.episodes)
        try:
            model = self._model(stage, env)
            if self._trainer_state is not None:
                self._restore(model, self._trainer_state)
            model.num_timesteps = self.progress.stage_steps
            monitor = Monitor(self, model, stage)
            model.policy.before_minibatch = self._check_stop
            remaining = stage.steps - self.progress.stage_steps
            try:
                if remaining > 0:
                    model.learn(remaining, callback=monitor, reset_num_timesteps=False)
            except InterruptedTrainingError:
                self.save(model)
                raise
            self.save(model)
            self._check_stop()
        finally:
            env.close()

    def _check_stop(self) -> None:
        if self.stop.asked:
            raise InterruptedTrainingError

    def _model(self, stage: PpoStage, env: Any) -> SequencePPO:
        model = SequencePPO(
            DrivingPolicy,
            env,
            learning_rate=stage.learning_rate.initial,
            n_steps=stage.rollout,
            batch_size=stage.minibatch,
            n_epochs=stage.epochs,
            gamma=stage.gamma,
            gae_lambda=stage.gae_lambda,
            clip_range=stage.clip,
            ent_coef=stage.entropy,
            vf_coef=stage.value,
            max_grad_norm=stage.max_grad_norm,
            target_kl=stage.target_kl,
            normalize_advantage=stage.normalise_advantage,
            reward_scale=stage.reward_scale,
            rollout_buffer_class=SequenceRolloutBuffer,
            rollout_buffer_kwargs={
                "segment": stage.segment,
                "prefix": self.network.prefix,
                "seed": derive_seed(self.recipe.seed, "minibatches", self.progress.stage, self.progress.stage_steps),
            },
            policy_kwargs={"network": self.network, "frozen": stage.freeze},
            seed=derive_seed(self.recipe.seed, "actions", self.progress.stage),
            device=self.device,
        )
        # SB3 hands a schedule the share of steps that remain; a step decay must count steps from the stage's start.
        model.lr_schedule = lambda _: stage.learning_rate.at(model.num_timesteps)
        return model

    def _restore(self, model: SequencePPO, state: dict[str, Any]) -> None:
        if "optimizer" in state:
            model.policy.optimizer.load_state_dict(state["optimizer"])
            torch.set_rng_state(state["torch_random"])
            if "cuda_random" in state and torch.cuda.is_available():
                torch.cuda.set_rng_state_all(state["cuda_random"])

    def save(self, model: SequencePPO) -> Path:
        """Write a checkpoint of the stage that is running."""
        state: dict[str, Any] = {
            "optimizer": model.policy.optimizer.state_dict(),
            "torch_random": torch.get_rng_state(),
        }
        if self.device.type == "cuda":
            state["cuda_random"] = torch.cuda.get_rng_state_all()
        return self._save(state)

    def _save(self, state: dict[str, Any]) -> Path:
        now = time.monotonic()
        self.progress.seconds += now - self._sitting
        self._sitting = now
        folder = save_checkpoint(self.run, self.network, self.recipe, self.progress, state)
        prune(self.run, KEEP)
        with suppress(ValueError):  # nothing to draw before the first update
            draw_curve(self.run, self.run / "reward.png")
        return folder

    def _finish(self, last: Path) -> None:
        rows = [json.loads(line) for line in (self.run / "metrics.jsonl").read_text().splitlines()]
        rewards = [row["reward_per_step"] for row in rows[-10:] if row.get("reward_per_step") is not None]
        summary = {
            "recipe": self.recipe.name,
            "seed": self.recipe.seed,
            "steps": self.progress.total_steps,
            "seconds": round(self.progress.seconds, 1),
            "reward_per_step": float(np.mean(rewards)) if rewards else None,
            "checkpoint": last.name,
            "parameters": sum(p.numel() for p in self.network.parameters()),
        }
        atomic_write_text(self.run / "summary.json", json.dumps(summary, indent=1))
