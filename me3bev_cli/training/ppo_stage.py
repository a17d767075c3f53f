"""A `ppo` stage: proximal policy optimisation in the simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stable_baselines3.common.logger import Logger

from me3bev_cli.errors import CheckpointError
from me3bev_cli.pipeline.policy import DrivingPolicy
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.alarms import WORKER, guard_gradients, guard_outputs
from me3bev_cli.training.demonstrations import Taught
from me3bev_cli.training.environments import first_episode_of, make_environments
from me3bev_cli.training.guidance import AutopilotGuide
from me3bev_cli.training.monitor import Monitor
from me3bev_cli.training.ppo_state import prepare
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
        self._state: dict[str, Any] | None = None

    def restore(self, state: dict[str, Any]) -> None:
        """The state is taken up once the model and the environments have been made."""
        if not {"environments", "monitor"} <= state.keys():
            raise CheckpointError("the checkpoint is of another version of me3bev and cannot be gone on from")
        self._state = state

    def run(self) -> None:
        """Train to the stage's last step.

        Raises:
            InterruptedTrainingError: a stop was asked for.
            AlarmError: something is wrong.
        """
        trainer, stage = self.trainer, self.stage
        remaining = stage.steps - trainer.progress.stage_steps
        if remaining <= 0:
            return
        env = make_environments(
            trainer.recipe,
            stage,
            first_episode_of(trainer.progress.stage),
            around=Taught if stage.guidance else None,
            told=lambda text: trainer.warn(WORKER, text),
            check=self._check_stop,
        )
        end = guard_outputs(trainer.network, trainer.run)
        try:
            model = self._model(env)
            guard_gradients(model.policy.optimizer, trainer.network, trainer.run)
            if self._state is not None:
                prepare(model, env, self._state, self._check_stop)
            model.num_timesteps = trainer.progress.stage_steps
            model.policy.before_minibatch = self._check_stop
            monitor = Monitor(trainer, stage, env, self._state)
            # The trainer writes the log; SB3's keeps the losses for it.
            model.set_logger(Logger(None, []))
            model.learn(remaining, callback=monitor, reset_num_timesteps=False)
        finally:
            end()
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
            policy_kwargs={
                "network": trainer.network,
                "frozen": stage.freeze,
                "autocast": stage.autocast,
                "microbatch": stage.microbatch,
                "guide": AutopilotGuide(stage.guidance) if stage.guidance else None,
            },
            seed=derive_seed(recipe.seed, "actions", progress.stage),
            device=trainer.device,
        )
        # SB3 hands a schedule the share of steps that remain; a step decay must count steps from the stage's start.
        model.lr_schedule = lambda _: stage.learning_rate.at(model.num_timesteps)
        return model
