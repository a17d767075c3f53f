"""Mamba, the paper's temporal module: a selective state space (Section III-D, eqs. 11-13)."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Literal

import torch
import torch.nn.functional as F
from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_cli.errors import UserError
from me3bev_plugins.temporal import native
from me3bev_plugins.temporal.scan import cleared, scan_step, selective_scan

Memory = dict[str, Tensor]
_EPSILON = 1e-5


class Mamba(nn.Module):
    """One Mamba block over vectors of `width` numbers.

    The state transition A-bar = exp(delta A), the input matrix B-bar = delta B and the observation matrix C
    are functions of the input (eq. 13); h_t = A-bar h_{t-1} + B-bar x_t (eq. 11); y_t = C h_t + D x_t (eq. 12).
    A causal depthwise convolution stands before the recurrence and a SiLU gate behind it. Parameters carry
    the names and shapes usual for Mamba blocks (in_proj, conv1d, x_proj, dt_proj, A_log, D, out_proj), so
    weights can be exchanged; `norm` and the residual lie around the block.

    State: `conv` (B, d_conv - 1, E), the last inputs of the convolution, and `ssm` (B, N, E), h.
    """

    class Config(PluginConfig):
        """Settings of the Mamba block."""

        expand: PositiveInt = Field(default=2, description="inner width E over outer width D")
        d_state: PositiveInt = Field(default=16, description="numbers of state per inner channel, N")
        d_conv: PositiveInt = Field(default=4, description="frames that the causal convolution spans")
        dt_rank: PositiveInt | Literal["auto"] = Field(
            default="auto", description="rank of the step size's projection; auto: width / 16, rounded up"
        )
        dt_min: float = Field(default=0.001, gt=0, description="smallest step size at the start of training")
        dt_max: float = Field(default=0.1, gt=0, description="largest step size at the start of training")
        residual: bool = Field(default=True, description="add the input to the output")
        norm: bool = Field(default=True, description="RMS-normalise the input")
        backend: Literal["auto", "torch", "native"] = Field(
            default="auto",
            description="native: kernels compiled for this CPU, in float32; auto: those where they can be had",
        )

    def __init__(self, config: Config, width: int) -> None:
        super().__init__()
        self.check(config, width)
        if config.backend == "native" and native.kernels() is None:
            raise UserError("backend 'native' needs numba, which does not load here; give 'auto' or 'torch'")
        self.config, self.width = config, width
        inner, states = config.expand * width, config.d_state
        self.inner = inner
        self._kept_rates: tuple[Tensor, Tensor] | None = None
        self.rank = math.ceil(width / 16) if config.dt_rank == "auto" else config.dt_rank
        self.norm = nn.RMSNorm(width, eps=_EPSILON) if config.norm else nn.Identity()
        self.in_proj = nn.Linear(width, 2 * inner, bias=False)
        self.conv1d = _Kernel(inner, config.d_conv)
        self.x_proj = nn.Linear(inner, self.rank + 2 * states, bias=False)
        self.dt_proj = nn.Linear(self.rank, inner)
        self.A_log = nn.Parameter(torch.arange(1, states + 1, dtype=torch.float32).log().repeat(inner, 1))
        self.D = nn.Parameter(torch.ones(inner))
        self.out_proj = nn.Linear(inner, width, bias=False)
        self._initialise_step_size()

    @classmethod
    def check(cls, config: Config, width: int) -> None:
        """Any positive width fits.

        Raises:
            ValueError: for an empty range of step sizes or a width below 1.
        """
        if width < 1:
            raise ValueError(f"width must be positive, not {width}")
        if config.dt_min > config.dt_max:
            raise ValueError(f"dt_min {config.dt_min} exceeds dt_max {config.dt_max}")

    def _initialise_step_size(self) -> None:
        """Draw the bias so that softplus(bias) is log-uniform between dt_min and dt_max."""
        low, high = math.log(self.config.dt_min), math.log(self.config.dt_max)
        bound = self.rank**-0.5
        with torch.no_grad():
            self.dt_proj.weight.uniform_(-bound, bound)
            step = torch.empty(self.inner).uniform_(low, high).exp_()
            self.dt_proj.bias.copy_(step + torch.log(-torch.expm1(-step)))

    def initial_state(self, batch: int) -> Memory:
        """Zeros: {"conv": (B, d_conv - 1, E), "ssm": (B, N, E)}."""
        like = self.D
        return {
            "conv": like.new_zeros(batch, self.config.d_conv - 1, self.inner),
            "ssm": like.new_zeros(batch, self.config.d_state, self.inner),
        }

    def forward(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        if self.config.backend != "torch" and native.suits(x, self.D, state["conv"], state["ssm"]):
            return self._native(x, state, starts)
        x = x.to(self.D.dtype)
        if x.shape[1] == 1 and not torch.is_grad_enabled() and not _autocast(x.device.type):
            return self._step(x[:, 0], state, starts[:, 0])
        y, state = self._sequence(self.norm(x), state, starts)
        return (x + y if self.config.residual else y), state

    def _native(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        """The same on native kernels."""
        weights = self._weights()
        native.check_shapes(weights, x, state["conv"], state["ssm"], starts)
        if x.shape[1] == 1 and x.numel() <= native.STEP_NUMBERS and not torch.is_grad_enabled():
            plan = native.plan(self, self.norm.weight if self.config.norm else None, weights)
            if plan is not None:
                y, conv, ssm = native.step(plan, x, state["conv"], state["ssm"], starts)
                return y, {"conv": conv, "ssm": ssm}
        y, conv, ssm = native.sequence(weights, self.norm(x), state["conv"], state["ssm"], starts)
        return (x + y if self.config.residual else y), {"conv": conv, "ssm": ssm}

    def _weights(self) -> native.Weights:
        # Looked up in the dicts, since asking the modules for ten attributes takes as long as half a step.
        projection, conv, selection, step, out = (
            self._modules[name]._parameters  # type: ignore[union-attr]
            for name in ("in_proj", "conv1d", "x_proj", "dt_proj", "out_proj")
        )
        own = self._parameters
        return native.Weights(
            projection["weight"], conv["weight"], conv["bias"], selection["weight"], step["weight"], step["bias"],
            own["A_log"], own["D"], out["weight"],
        )  # type: ignore[arg-type]  # fmt: skip

    def _sequence(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        inner, gate = self.in_proj(x).chunk(2, dim=-1)
        past = cleared(state["conv"], starts[:, 0])
        inner, conv = _causal_conv(inner, past, starts, self.conv1d.weight, self.conv1d.bias)
        inner = F.silu(inner)
        step, B, C = self.x_proj(inner).split([self.rank, self.config.d_state, self.config.d_state], dim=-1)
        delta = F.softplus(self.dt_proj(step))
        A = -torch.exp(self.A_log.T.contiguous())
        with _full_precision(x.device.type):
            dtype = self.A_log.dtype
            y, ssm = selective_scan(inner.to(dtype), delta.to(dtype), A, B.to(dtype), C.to(dtype), state["ssm"], starts)
        y = (y + self.D * inner) * F.silu(gate)
        return self.out_proj(y), {"conv": conv, "ssm": ssm}

    def _step(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        """One frame without gradients, x (B, D), norm and residual included, in as few operations as possible.

        At this size an operation costs as much as its arithmetic; torch's own norm is eight of them on a CPU.
        """
        weights, rank, states = self._weights(), self.rank, self.config.d_state
        conv, ssm = state["conv"], state["ssm"]
        if not starts.is_cpu or True in starts.tolist():
            conv, ssm = (part.masked_fill(starts[:, None, None], 0.0) for part in (conv, ssm))
        both = F.linear(self._normed(x), weights.in_proj)
        taps = torch.cat([conv, both[:, None, : self.inner]], dim=1)
        u = (taps * weights.conv_weight.permute(1, 2, 0)).sum(1).add_(weights.conv_bias)
        u = F.silu(u, inplace=True)
        selected = F.linear(u, weights.x_proj)
        delta = F.softplus(F.linear(selected[:, :rank], weights.dt_proj, weights.dt_bias))
        B, C = selected[:, rank : rank + states], selected[:, rank + states :]
        y, ssm = scan_step(u, delta, self._rates(), B, C, ssm)
        y.addcmul_(weights.D, u).mul_(F.silu(both[:, self.inner :]))
        y = F.linear(y, weights.out_proj)
        y = y.add_(x) if self.config.residual else y
        return y[:, None], {"conv": taps[:, 1:], "ssm": ssm}

    def _normed(self, x: Tensor) -> Tensor:
        """`norm` of x (B, D)."""
        if not isinstance(self.norm, nn.RMSNorm):
            return x
        scale = (x * x).sum(-1, keepdim=True).mul_(1 / self.width).add_(_EPSILON).rsqrt_()
        return scale.mul(x).mul_(self.norm.weight)

    def _rates(self) -> Tensor:
        """A (N, E); on a CPU kept from the last frame, since comparing A_log costs less than its exponential."""
        kept, now = self._kept_rates, self.A_log
        if kept is not None and now.is_cpu and kept[0].dtype == now.dtype and torch.equal(kept[0], now):
            return kept[1]
        rates = torch.exp(self.A_log.T.contiguous()).neg_()
        self._kept_rates = self.A_log.detach().clone(), rates
        return rates


def _autocast(device: str) -> bool:
    return torch.amp.is_autocast_available(device) and torch.is_autocast_enabled(device)


def _full_precision(device: str) -> AbstractContextManager[Any]:
    """Without autocast."""
    return torch.autocast(device, enabled=False) if _autocast(device) else nullcontext()


class _Kernel(nn.Module):
    """The taps and biases of a depthwise convolution, named and shaped as torch's Conv1d has them."""

    def __init__(self, channels: int, taps: int) -> None:
        super().__init__()
        bound = taps**-0.5
        self.weight = nn.Parameter(torch.empty(channels, 1, taps).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(channels).uniform_(-bound, bound))


def _causal_conv(x: Tensor, past: Tensor, starts: Tensor, weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
    """Depthwise convolution over time that sees neither later frames nor those before an episode's start.

    Args:
        x: (B, T, E).
        past: (B, K - 1, E), the frames before.
        starts: (B, T) bool.
        weight: (E, 1, K), the last tap for the present frame.

    Returns:
        (B, T, E) and the new past (B, K - 1, E), zero where it belongs to an earlier episode.
    """
    taps, frames = weight.shape[-1], x.shape[1]
    episode = starts.cumsum(1)
    episode = torch.cat([episode.new_zeros(len(x), taps - 1), episode], dim=1)
    line = torch.cat([past.to(x.dtype), x], dim=1)
    y = torch.addcmul(bias, line[:, taps - 1 :], weight[:, 0, -1])
    for tap in range(taps - 1):
        same = episode[:, tap : tap + frames] == episode[:, taps - 1 :]
        y = torch.addcmul(y, line[:, tap : tap + frames] * same.unsqueeze(-1), weight[:, 0, tap])
    return y, _tail(line, episode, taps - 1)


def _tail(line: Tensor, episode: Tensor, length: int) -> Tensor:
    """The last `length` frames of `line` that belong to the episode of the last one; zeros for the rest."""
    first = line.shape[1] - length
    same = episode[:, first:] == episode[:, -1:]
    return line[:, first:] * same.unsqueeze(-1)
