"""Actor and critic heads: from the fused vector u to a distribution over actions and a value."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.distributions import Beta, Independent, Normal
from torch.distributions.transforms import AffineTransform

ACTIONS = 2


def mlp(widths: Sequence[int], activation: type[nn.Module], last: bool = True) -> nn.Sequential:
    """Linear layers of the given widths with `activation` between them, and after the last one if `last`."""
    layers: list[nn.Module] = []
    for index, (a, b) in enumerate(pairwise(widths)):
        layers.append(nn.Linear(a, b))
        if last or index < len(widths) - 2:
            layers.append(activation())
    return nn.Sequential(*layers)


class GaussianActions:
    """A diagonal Gaussian over (B, 2) actions; samples may leave [-1, 1] and are clipped by who applies them."""

    def __init__(self, mean: Tensor, log_std: Tensor) -> None:
        self._mean = mean
        self._normal = Independent(Normal(mean, log_std.exp().expand_as(mean)), 1)

    def sample(self) -> Tensor:
        return self._normal.sample()

    def mode(self) -> Tensor:
        return self._mean

    def log_prob(self, actions: Tensor) -> Tensor:
        """(B,)"""
        log_prob: Tensor = self._normal.log_prob(actions)  # type: ignore[no-untyped-call]
        return log_prob

    def entropy(self) -> Tensor:
        """(B,)"""
        entropy: Tensor = self._normal.entropy()  # type: ignore[no-untyped-call]
        return entropy


class BetaActions:
    """Independent Beta distributions stretched from (0, 1) to (-1, 1): bounded actions, as the baseline's."""

    EDGE = 1e-6

    def __init__(self, alpha: Tensor, beta: Tensor) -> None:
        self._beta = Independent(Beta(alpha, beta), 1)
        self._stretch = AffineTransform(-1.0, 2.0)
        # d(action) = 2 d(sample) in each of the two axes.
        self._log_scale = ACTIONS * torch.log(torch.tensor(2.0, dtype=alpha.dtype, device=alpha.device))

    def sample(self) -> Tensor:
        return self._stretch(self._beta.sample())

    def mode(self) -> Tensor:
        """The mean: the mode of a Beta is undefined where alpha or beta is 1."""
        return self._stretch(self._beta.mean)

    def log_prob(self, actions: Tensor) -> Tensor:
        """(B,)"""
        inside = ((actions + 1) / 2).clamp(self.EDGE, 1 - self.EDGE)
        log_prob: Tensor = self._beta.log_prob(inside)  # type: ignore[no-untyped-call]
        return log_prob - self._log_scale

    def entropy(self) -> Tensor:
        """(B,)"""
        entropy: Tensor = self._beta.entropy()  # type: ignore[no-untyped-call]
        return entropy + self._log_scale


Actions = GaussianActions | BetaActions


class Actor(nn.Module):
    """u (B, D) -> a distribution over (steering, longitudinal)."""

    def __init__(
        self, width: int, hidden: Sequence[int], activation: type[nn.Module], distribution: str, initial_log_std: float
    ) -> None:
        super().__init__()
        self.distribution = distribution
        self.body = mlp([width, *hidden], activation)
        outputs = ACTIONS if distribution == "gaussian" else 2 * ACTIONS
        self.out = nn.Linear([width, *hidden][-1], outputs)
        # Small first actions: the untrained policy starts near the middle of the range.
        nn.init.orthogonal_(self.out.weight, gain=0.01)
        nn.init.zeros_(self.out.bias)
        if distribution == "gaussian":
            self.log_std = nn.Parameter(torch.full((ACTIONS,), float(initial_log_std)))

    def forward(self, u: Tensor) -> Actions:
        out = self.out(self.body(u)).float()
        if self.distribution == "gaussian":
            return GaussianActions(out, self.log_std)
        alpha, beta = (nn.functional.softplus(out) + 1.0).chunk(2, dim=-1)
        return BetaActions(alpha, beta)


class Critic(nn.Module):
    """u (B, D) -> value (B,)."""

    def __init__(self, width: int, hidden: Sequence[int], activation: type[nn.Module]) -> None:
        super().__init__()
        self.body = mlp([width, *hidden], activation)
        self.out = nn.Linear([width, *hidden][-1], 1)
        nn.init.orthogonal_(self.out.weight, gain=1.0)
        nn.init.zeros_(self.out.bias)

    def forward(self, u: Tensor) -> Tensor:
        return self.out(self.body(u)).squeeze(-1).float()
