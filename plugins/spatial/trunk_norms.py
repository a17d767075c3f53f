"""What a trunk does with normalisation: nothing that depends on the batch survives.

Batch statistics would make the network that acts on one frame another than the one that learns from hundreds. So a
trunk either has its batch norms replaced by group norms (training from scratch), or keeps them frozen at the statistics
that came with the pretrained weights. Dropout and stochastic depth are removed for the same reason.
"""

from __future__ import annotations

from torch import nn

from me3bev_plugins.spatial.blocks import group_norm

_BY_CHANCE = ("StochasticDepth", "DropPath", "DropBlock2d")
"""Classes of torchvision and timm, by name: timm need not be installed."""


class FrozenBatchNorm(nn.BatchNorm2d):
    """Batch normalisation that always uses its stored statistics; its scale and shift go on learning."""

    def train(self, mode: bool = True) -> FrozenBatchNorm:
        """Stay in evaluation mode."""
        super().train(False)
        return self


def settle(module: nn.Module, frozen: bool) -> None:
    """Take out everything that depends on the batch or on chance, in place.

    Args:
        module: whose parts are replaced.
        frozen: keep batch norms at their statistics instead of putting group norms in their place.
    """
    for label, child in module.named_children():
        if isinstance(child, nn.BatchNorm2d):
            setattr(module, label, _replaced(child, frozen))
        elif isinstance(child, nn.Dropout) or type(child).__name__ in _BY_CHANCE:
            setattr(module, label, nn.Identity())
        else:
            settle(child, frozen)


def _replaced(norm: nn.BatchNorm2d, frozen: bool) -> nn.Module:
    still = _frozen(norm) if frozen else group_norm(norm.num_features)
    # timm's batch norms hold the activation that follows them.
    activation = getattr(norm, "act", None)
    return nn.Sequential(still, activation) if isinstance(activation, nn.Module) else still


def _frozen(norm: nn.BatchNorm2d) -> FrozenBatchNorm:
    still = FrozenBatchNorm(norm.num_features, eps=norm.eps)
    own = still.state_dict()
    still.load_state_dict({name: value for name, value in norm.state_dict().items() if name in own})
    return still.train()
