"""A `ppo` stage: proximal policy optimisation in the simulator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from me3bev_cli.pipeline.policy import DrivingPolicy
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.monitor import Monitor
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.sequence_ppo import SequencePPO
from me3bev_cli.training.trainer import InterruptedTrainingError

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import PpoStage
    from me3bev_cli.training.trainer import Trainer


class PpoRunner:
    """Runs SB3's PPO on sequences."""

    def __init__(self, trainer: Trainer, stage: PpoStage) -> None:
        self.trainer, self.stage = trainer, stage
        self._state: dict[str, Any] = {}

    def restore(self, state: dict[str, Any]) -> None:
        """Optimiser and random states are taken up once the model has been made."""
        self._state = state

    def run(self) -> None:
        """Train to the stage's last step."""
        trainer, stage = self.trainer, self.stage
        env = make_environments(trainer.recipe, stage, trainer.progress.episodes)
        try:
            model = self._model(env)
            if self._state:
                self._take_up(model)
            model.num_timesteps = trainer.progress.stage_steps
            model.policy.before_minibatch = self._check_stop
            remaining = stage.steps - trainer.progress.stage_steps
            try:
                if remaining > 0:
                    model.learn(remaining, callback=Monitor(self, model), reset_num_timesteps=False)
            except InterruptedTrainingError:
                self.save(model)
                raise
            self.save(model)
            self._check_stop()
        finally:
            env.close()

    def _check_stop(self) -> None:
        if self.trainer.stopping:
            raise InterruptedTrainingError

    def _model(self, env: Any) -> SequencePPO:
        trainer, stage = self.trainer, self.stage
        recipe, progress = trainer.recipe, trainer.progress
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
                "prefix": trainer.network.prefix,
                "seed": derive_seed(recipe.seed, "minibatches", progress.stage, progress.stage_steps),
            },
            policy_kwargs={"network": trainer.network, "frozen": stage.freeze},
            seed=derive_seed(recipe.seed, "actions", progress.stage),
            device=trainer.device,
        )
        # SB3 hands a schedule the share of steps that remain; a step decay must count steps from the stage's start.
        model.lr_schedule = lambda _: stage.learning_rate.at(model.num_timesteps)
        return model

    def _take_up(self, model: SequencePPO) -> None:
        model.policy.optimizer.load_state_dict(self._state["optimizer"])
        torch.set_rng_state(self._state["torch_random"])
        if "cuda_random" in self._state and torch.cuda.is_available():
            torch.cuda.set_rng_state_all(self._state["cuda_random"])

    def save(self, model: SequencePPO) -> Path:
        """Write a checkpoint of the stage that is running."""
        state: dict[str, Any] = {
            "optimizer": model.policy.optimizer.state_dict(),
            "torch_random": torch.get_rng_state(),
        }
        if self.trainer.device.type == "cuda":
            state["cuda_random"] = torch.cuda.get_rng_state_all()
        return self.trainer.save(state)
