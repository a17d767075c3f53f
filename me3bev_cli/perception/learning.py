"""Gradient steps of perception."""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from me3bev_cli.perception.batches import Batch
from me3bev_cli.perception.losses import depth_loss, segmentation_losses
from me3bev_cli.perception.model import PerceptionModel

if TYPE_CHECKING:
    from me3bev_cli.recipe_stages import PerceptionStage


class Learner:
    """The model, its optimiser and its losses.

    Args:
        class_weights: (8,) of the cross entropy.
    """

    def __init__(self, model: PerceptionModel, stage: PerceptionStage, class_weights: Tensor) -> None:
        self.model, self.stage = model, stage
        self.device = next(model.parameters()).device
        self.class_weights = class_weights.to(self.device)
        model.weigh(self.class_weights)
        self.parameters = [p for p in model.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(
            self.parameters, lr=stage.learning_rate.initial, weight_decay=stage.weight_decay
        )
        self.autocast: torch.dtype | None = None if stage.autocast is None else getattr(torch, stage.autocast)

    def rate(self, step: float) -> float:
        """The learning rate after so many environment steps of the stage."""
        stage = self.stage
        rising = min(1.0, (step + 1) / stage.warmup) if stage.warmup else 1.0
        wave = 0.5 * (1 + math.cos(math.pi * min(1.0, step / stage.steps)))
        return stage.learning_rate.at(int(step)) * rising * (stage.anneal + (1 - stage.anneal) * wave)

    def learn(self, batch: Batch, step: float) -> dict[str, Tensor]:
        """One gradient step; the losses, before it."""
        rate = self.rate(step)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        losses = self._losses(batch)
        self.optimizer.zero_grad()
        losses["loss"].backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.parameters, self.stage.max_grad_norm)
        self.optimizer.step()
        return {name: loss.detach() for name, loss in losses.items()}

    def _losses(self, batch: Batch) -> dict[str, Tensor]:
        stage = self.stage
        with nullcontext() if self.autocast is None else torch.autocast(self.device.type, self.autocast):
            seen = self.model(batch.images, tokens=stage.tokens > 0, stretch=batch.stretch)
        entropy, dice = segmentation_losses(seen.scores.float(), batch.truth, self.class_weights, batch.cells)
        losses = {"segmentation_loss": entropy, "dice_loss": dice}
        total = entropy + stage.dice * dice
        if seen.token_scores is not None:
            scores = seen.token_scores.float()
            entropy, dice = segmentation_losses(scores, batch.truth, self.class_weights, batch.cells)
            losses["token_loss"] = entropy + stage.dice * dice
            total = total + stage.tokens * losses["token_loss"]
        if stage.depth and seen.depth_logits is not None and batch.depth.shape[2]:
            losses["depth_loss"] = depth_loss(seen.depth_logits.float(), batch.depth)
            total = total + stage.depth * losses["depth_loss"]
        return losses | {"loss": total}

    def state(self) -> dict[str, Any]:
        """What `restore` takes up, beside the spatial part's weights."""
        return {
            "heads": self.model.heads().state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "class_weights": self.class_weights.cpu(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from where `state` was taken."""
        self.model.heads().load_state_dict(state["heads"])
        self.optimizer.load_state_dict(state["optimizer"])
