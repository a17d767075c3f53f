"""The autopilot's part in a `ppo` stage: the policy's mean action is drawn to what the autopilot would do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from me3bev_cli.training.demonstrations import LABEL

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import Guidance


class _Along(torch.autograd.Function):
    """Passes a tensor on unchanged; whoever descends what is made of it descends `loss` too, once."""

    @staticmethod
    def forward(ctx: Any, tensor: Tensor, loss: Tensor) -> Tensor:
        ctx.like = torch.ones_like(loss)
        return tensor.view_as(tensor)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor]:
        return gradients[0], ctx.like


class AutopilotGuide:
    """The mean weighted squared distance of mean actions from the autopilot's, beside PPO's own loss.

    Stable-Baselines3 puts that loss together from log-probabilities, values and entropies: this one comes in with the
    gradient of the log-probabilities, whose values stay as they are.

    Args:
        guidance: the weights.
    """

    key = LABEL

    def __init__(self, guidance: Guidance) -> None:
        self.weight, self.weights = guidance.weight, (guidance.steering_weight, 1.0)
        self._losses: list[Tensor] = []

    def __call__(self, labels: Tensor, modes: Tensor, log_probs: Tensor) -> Tensor:
        """The autopilot's actions (N, 2) and the policy's mean ones -> log-probabilities (N,), the same numbers."""
        distance = ((modes - labels).square() * modes.new_tensor(self.weights)).sum(-1).mean()
        self._losses.append(distance.detach())
        along: Tensor = _Along.apply(log_probs, self.weight * distance)
        return along

    def told(self) -> float:
        """The mean distance since the last call."""
        mean = float(torch.stack(self._losses).mean())
        self._losses.clear()
        return mean
