"""A causal transformer with rotary positions as temporal module; it streams over a rolling cache."""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import PluginConfig
from me3bev_plugins.temporal.rotary import rotate, rotation

Memory = dict[str, Tensor]


class Transformer(nn.Module):
    """`layers` pre-norm blocks in which a frame attends to the last `context` frames of its episode.

    The cache holds keys before their rotation: positions are counted from the oldest place of the cache, so a
    frame's angles never grow however long an episode is, and scores depend on distances alone.

    State: `keys` and `values` (B, layers, context - 1, D), newest last, and `count` (B,), how many of the
    places hold frames of the running episode.
    """

    class Config(PluginConfig):
        """Settings of the transformer."""

        layers: PositiveInt = Field(default=1, description="blocks")
        heads: PositiveInt = Field(default=4, description="attention heads; the width must be an even multiple")
        context: PositiveInt = Field(
            default=16, description="frames that a frame attends to, itself included; memory and cost grow with it"
        )
        expand: PositiveInt = Field(default=4, description="width of the feed-forward layer over the width")
        base: float = Field(default=10000.0, gt=1, description="longest wavelength of the rotary positions")

    def __init__(self, config: Config, width: int) -> None:
        super().__init__()
        self.check(config, width)
        self.config, self.width = config, width
        self.blocks = nn.ModuleList(_Block(config, width) for _ in range(config.layers))
        self.norm = nn.LayerNorm(width)

    @classmethod
    def check(cls, config: Config, width: int) -> None:
        """The width must divide into heads of an even number.

        Raises:
            ValueError: when it does not.
        """
        if width < 1 or width % (2 * config.heads):
            step = 2 * config.heads
            raise ValueError(
                f"{config.heads} heads with rotary positions need a multiple of {step} as width, not {width}"
            )

    def initial_state(self, batch: int) -> Memory:
        """An empty cache."""
        like = self.norm.weight
        shape = (batch, self.config.layers, self.config.context - 1, self.width)
        return {
            "keys": like.new_zeros(shape),
            "values": like.new_zeros(shape),
            "count": torch.zeros(batch, dtype=torch.long, device=like.device),
        }

    def forward(self, x: Tensor, state: Memory, starts: Tensor) -> tuple[Tensor, Memory]:
        """x (B, T, D), starts (B, T) bool -> y (B, T, D) and the state after the last frame."""
        frames, places = x.shape[1], self.config.context - 1
        past = min(places, int(state["count"].max())) if len(x) else 0
        allowed, count = _allowed(starts, state["count"], past, places)
        positions = torch.arange(past + frames, device=x.device)
        cosine, sine = rotation(positions, self.width // self.config.heads, self.config.base)
        keys, values = [], []
        for layer, block in enumerate(self.blocks):
            cached = state["keys"][:, layer], state["values"][:, layer]
            recent = cached[0][:, places - past :], cached[1][:, places - past :]
            x, key, value = block(x, recent, allowed, (cosine, sine))
            keys.append(_newest(cached[0], key, places))
            values.append(_newest(cached[1], value, places))
        return self.norm(x), {"keys": torch.stack(keys, 1), "values": torch.stack(values, 1), "count": count}


class _Block(nn.Module):
    """Attention and a feed-forward layer, each on normalised input and added to it."""

    def __init__(self, config: Transformer.Config, width: int) -> None:
        super().__init__()
        self.heads = config.heads
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        inner = config.expand * width
        self.feed = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, inner), nn.GELU(), nn.Linear(inner, width))

    def forward(
        self, x: Tensor, cached: tuple[Tensor, Tensor], allowed: Tensor, turn: tuple[Tensor, Tensor]
    ) -> tuple[Tensor, Tensor, Tensor]:
        """x (B, T, D), cached keys and values (B, P, D) -> y, and the new keys and values, each (B, T, D)."""
        query, key, value = self.query_key_value(self.attention_norm(x)).chunk(3, dim=-1)
        frames = x.shape[1]
        cosine, sine = turn
        all_keys = self._split(torch.cat([cached[0].to(key.dtype), key], dim=1))
        all_values = self._split(torch.cat([cached[1].to(value.dtype), value], dim=1))
        queries = rotate(self._split(query), cosine[-frames:], sine[-frames:])
        seen = F.scaled_dot_product_attention(
            queries, rotate(all_keys, cosine, sine), all_values, attn_mask=allowed.unsqueeze(1)
        )
        x = x + cast(Tensor, self.attention_out(seen.transpose(1, 2).flatten(2)))
        return x + cast(Tensor, self.feed(x)), key, value

    def _split(self, x: Tensor) -> Tensor:
        """(B, T, D) -> (B, heads, T, D / heads)."""
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


def _allowed(starts: Tensor, count: Tensor, past: int, places: int) -> tuple[Tensor, Tensor]:
    """Which of `past` cached and T new frames each new frame may see, and the new count of cached frames.

    Args:
        starts: (B, T) bool.
        count: (B,), valid frames at the end of the cache.
        past: how many of the cache's last places are looked at.
        places: frames that the cache holds; the context is one more.

    Returns:
        (B, T, past + T) bool and (B,).
    """
    frames = starts.shape[1]
    episode = starts.cumsum(1)
    line = torch.arange(past + frames, device=starts.device)
    old = torch.where(line[:past] >= past - count[:, None], 0, -1)
    distance = line[past:, None] - line
    near = (distance >= 0) & (distance <= places)
    allowed = near & (episode.unsqueeze(2) == torch.cat([old, episode], dim=1).unsqueeze(1))
    alive = (episode == episode[:, -1:]).sum(1) + count * (episode[:, -1] == 0)
    return allowed, alive.clamp(max=places)


def _newest(cached: Tensor, new: Tensor, places: int) -> Tensor:
    """The last `places` of cached (B, places, D) followed by new (B, T, D)."""
    kept = max(places - new.shape[1], 0)
    return torch.cat([cached[:, places - kept :], new[:, new.shape[1] - (places - kept) :].to(cached.dtype)], dim=1)
