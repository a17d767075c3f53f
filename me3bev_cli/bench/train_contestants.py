"""Who is compared by `bench-train`: sequence PPO and plain Stable-Baselines3, made from one recipe."""

from __future__ import annotations

import time
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv

from me3bev_cli.bench.train_stacked import StackedPolicy
from me3bev_cli.errors import UserError
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.policy import STARTS, DrivingPolicy
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_stages import PpoStage
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.rollout import SequenceRolloutBuffer
from me3bev_cli.training.sequence_ppo import SequencePPO


class Quiet(BaseCallback):
    """Watches nothing."""

    def _on_step(self) -> bool:
        return True


class Contest:
    """The models that are compared, made from one recipe.

    Args:
        recipe: whose first ppo stage is measured; its context is a window.
        samples: of a minibatch; rounded up to whole segments.

    Raises:
        UserError: the recipe has no such stage, no window, or no images.
    """

    def __init__(self, recipe: Recipe, samples: int) -> None:
        stage = next((stage for stage in recipe.stages if isinstance(stage, PpoStage)), None)
        if stage is None:
            raise UserError(f"recipe '{recipe.name}' has no ppo stage", hint="There is nothing to compare")
        if recipe.context.kind != "window" or recipe.temporal is None or "bev" not in recipe.modalities:
            raise UserError(
                f"recipe '{recipe.name}' does not look at a window of images: stacked frames have no counterpart in it",
                hint="Give it modalities with bev, a temporal module and `context: {kind: window, length: 4}`",
            )
        self.recipe, self.stage, self.length = recipe, stage, recipe.context.length
        self.device = pick_device(recipe.device)
        self.samples = -(-samples // stage.segment) * stage.segment

    def envs(self, count: int) -> VecEnv:
        """As the stage has them, but so many."""
        return make_environments(self.recipe, self.stage.model_copy(update={"envs": count}))

    def settings(self, steps: int, minibatch: int) -> dict[str, Any]:
        """What both algorithms are told. The weights stay as they are, whatever the optimiser does."""
        stage = self.stage
        return {
            "learning_rate": 0.0, "n_steps": steps, "batch_size": minibatch, "n_epochs": 1, "gamma": stage.gamma,
            "gae_lambda": stage.gae_lambda, "clip_range": stage.clip, "ent_coef": stage.entropy,
            "vf_coef": stage.value, "max_grad_norm": stage.max_grad_norm,
            "normalize_advantage": stage.normalise_advantage, "seed": self.recipe.seed, "device": self.device,
        }  # fmt: skip

    def network(self, frozen: bool) -> dict[str, Any]:
        """The same weights for everybody, in what both policies are told."""
        network = build_network(self.recipe, self.recipe.seed).to(self.device)
        parts = ("spatial",) if frozen else ()
        return {"network": network, "frozen": parts, "microbatch": self.stage.microbatch}

    def ours(self, envs: VecEnv, steps: int, frozen: bool = False) -> SequencePPO:
        """Single frames in segments; embeddings where the encoder is frozen."""
        told = self.network(frozen) | {"autocast": self.stage.autocast}
        sequence = {"segment": self.stage.segment, "prefix": told["network"].prefix, "seed": 0}
        model = SequencePPO(
            DrivingPolicy,
            envs,
            rollout_buffer_class=SequenceRolloutBuffer,
            rollout_buffer_kwargs=sequence,
            policy_kwargs=told,
            **self.settings(steps, min(self.samples, steps * envs.num_envs)),
        )
        model.set_logger(Logger(None, []))
        return model

    def plain(self, envs: VecEnv, steps: int, frozen: bool = False) -> PPO:
        """SB3's own PPO and buffer on stacked frames."""
        told = self.network(frozen) | {"autocast": self.stage.autocast}
        model = PPO(StackedPolicy, envs, policy_kwargs=told, **self.settings(steps, self.samples))  # type: ignore[arg-type]
        model.set_logger(Logger(None, []))
        return model

    def clock(self) -> float:
        """Seconds, when the device has done what it was given."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()


def collect(model: PPO, steps: int) -> None:
    """Fill the model's buffer, with the same chance for everybody.

    The rollout kept is the second one: the first begins with an episode, and needs no frames from before.
    """
    assert model.env is not None
    torch.manual_seed(0)
    _, callback = model._setup_learn(steps, Quiet())
    for _ in range(2):
        model.collect_rollouts(model.env, callback, model.rollout_buffer, steps)


def fill_stacked(target: DictRolloutBuffer, source: SequenceRolloutBuffer) -> None:
    """Put the samples of a rollout of single frames into SB3's buffer, each with its window."""
    length = source.prefix + 1
    for t in range(source.buffer_size):
        seen = {key: array[t : t + length].swapaxes(0, 1) for key, array in source.frames.items()}
        target.add(
            seen | {STARTS: source.starts[t : t + length].T},
            source.actions[t],
            source.rewards[t],
            source.episode_starts[t],
            torch.as_tensor(source.values[t]),
            torch.as_tensor(source.log_probs[t]),
        )
    target.advantages, target.returns = source.advantages.copy(), source.returns.copy()
