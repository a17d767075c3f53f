"""What can go wrong while a run learns, and the errors that say so. Each keeps the last good checkpoint."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.recipe_alarms import Alarms

USUAL_KL = 0.03
"""What an update's KL is measured by where a recipe sets no target_kl."""

WORKER, KL, ENTROPY, CHECKPOINT = "worker", "kl", "entropy", "checkpoint"
"""Kinds of alarms that a run goes on after."""


class AlarmError(UserError):
    """Training stopped because something is wrong; the last good checkpoint stands."""


class NonFiniteError(AlarmError):
    """A reward, an output of the network, a loss or a gradient is no finite number."""


class AstrayError(AlarmError):
    """The policy changes far more than it should, or has stopped to try anything, and the recipe says to stop then."""


class DiskError(AlarmError):
    """The run folder cannot be written, as when the disk is full."""


def disk_error(path: Path, error: OSError, run: Path, last: Path | None) -> DiskError:
    """The error for a file that cannot be written.

    Args:
        last: the newest checkpoint that is whole.
    """
    kept = f"The last good checkpoint is {last.name}" if last is not None else "There is no checkpoint yet"
    return DiskError(
        f"cannot be written: {error.strerror or error}",
        where=str(path),
        hint=f"{kept}. Make room, then go on with: me3bev train --resume {run}",
    )


def repeats(run: Path) -> str:
    """What to do about an alarm that going on unchanged would raise again."""
    return (
        "Going on unchanged would come to the same point: lower learning_rate or max_grad_norm in "
        f"{run / 'recipe.yaml'}, then: me3bev train --resume {run}"
    )


def all_finite(tensors: Iterable[Tensor]) -> bool:
    """Whether every number is finite; one look at the device for all."""
    norms = torch._foreach_norm(list(tensors), float("inf"))
    return bool(torch.isfinite(torch.stack([norm.float() for norm in norms])).all()) if norms else True


def guard_gradients(optimizer: torch.optim.Optimizer, module: nn.Module, run: Path) -> None:
    """From now on look at the gradients before each step of the optimiser.

    A loss that is not finite has gradients that are not, so that this catches both; the weights stay as they are.

    Raises (in the step):
        NonFiniteError: one of them is not finite.
    """

    def look(*_: Any) -> None:
        if not all_finite(p.grad for p in module.parameters() if p.grad is not None):
            bad = [n for n, p in module.named_parameters() if p.grad is not None and not torch.isfinite(p.grad).all()]
            raise NonFiniteError(
                f"the loss or its gradient is not finite ({len(bad)} parameters, first '{bad[0]}'); "
                "the weights were left as they were",
                hint=repeats(run),
            )

    optimizer.register_step_pre_hook(look)


def guard_outputs(network: Any, run: Path) -> Callable[[], None]:
    """From now on look at what the actor and the critic give; returns what ends that.

    Raises (in the forward pass):
        NonFiniteError: an output is not finite, as from an observation that is not.
    """

    def look(module: nn.Module, inputs: Any, output: Tensor) -> None:
        if not torch.isfinite(output).all():
            name = "actor" if module is network.actor.out else "critic"
            raise NonFiniteError(
                f"the {name}'s output is not finite: the weights are too large, or an observation is not finite",
                hint=repeats(run),
            )

    hooks = [head.out.register_forward_hook(look) for head in (network.actor, network.critic)]

    def end() -> None:
        for hook in hooks:
            hook.remove()

    return end


def check_losses(values: Mapping[str, Any], run: Path) -> None:
    """Look at what an update has told: clipping makes nothing of a gradient that is too long to be measured, so that
    a loss may be infinite while every gradient is finite.

    Raises:
        NonFiniteError: a loss is not finite.
    """
    for key in ("train/loss", "train/value_loss", "train/policy_gradient_loss", "train/approx_kl"):
        if key in values and not np.isfinite(values[key]):
            raise NonFiniteError(
                f"{key.removeprefix('train/')} of the last update is {values[key]}; the update is not kept",
                hint=repeats(run),
            )


def check_rewards(rewards: NDArray[np.floating[Any]], episodes: list[int]) -> None:
    """Look at the rewards of a step, one for each environment.

    Raises:
        NonFiniteError: one is not finite.
    """
    wrong = np.flatnonzero(~np.isfinite(rewards))
    if len(wrong):
        index = int(wrong[0])
        raise NonFiniteError(
            f"the simulator gave the reward {rewards[index]} in environment {index}, episode {episodes[index]}",
            hint="The cause is in the simulator or in the recipe's reward; going on unchanged would give the same",
        )


class Watch:
    """Looks at each update's KL and entropy.

    Args:
        target: the recipe's target_kl.
        told: called with the kind of an alarm and a sentence.
    """

    def __init__(self, limits: Alarms, target: float | None, run: Path, told: Callable[[str, str], None]) -> None:
        self.limits, self.run, self.told = limits, run, told
        self.limit = limits.kl * (target or USUAL_KL)
        self.far, self.narrow = 0, 0
        """Updates in a row whose KL was far off, and whose entropy was below the limit."""

    def update(self, kl: float | None, entropy: float | None) -> None:
        """Look at one update.

        Raises:
            AstrayError: something is wrong, and the recipe says to stop then.
        """
        self.far = self.far + 1 if kl is not None and kl > self.limit else 0
        self.narrow = self.narrow + 1 if entropy is not None and entropy < self.limits.entropy else 0
        if self.far == self.limits.updates:
            self._say(KL, f"the KL was over {self.limit:g} in {self.far} updates in a row, last {kl:.3g}")
        if self.narrow == self.limits.updates:
            self._say(
                ENTROPY,
                f"the policy's entropy was below {self.limits.entropy:g} in {self.narrow} updates in a row, "
                f"last {entropy:.3g}: it hardly tries anything any more",
            )

    def _say(self, kind: str, what: str) -> None:
        if self.limits.stop:
            raise AstrayError(what, hint=repeats(self.run))
        self.told(kind, what)

    def state(self) -> list[int]:
        """What `restore` needs."""
        return [self.far, self.narrow]

    def restore(self, state: list[int]) -> None:
        """Take up counting."""
        self.far, self.narrow = state
