"""Episodes inside a batch as one packed sequence, so that fused recurrent kernels need no loop over frames."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.utils.rnn import PackedSequence


class Segments(NamedTuple):
    """Rows of (B, T) cut at their starts into S segments, ordered by falling length."""

    order: Tensor
    """(B * T,): for each place in the packed data, the flat frame b * T + t it comes from."""
    place: Tensor
    """(B * T,): its inverse."""
    sizes: Tensor
    """How many segments are still running at each step; on the CPU, as torch's packed sequences want it."""
    row: Tensor
    """(S,): the row that each segment lies in."""
    fresh: Tensor
    """(S,) bool: whether it begins with an empty memory instead of the row's."""
    last: Tensor
    """(B,): the segment in which each row ends."""


def cut(starts: Tensor) -> Segments:
    """Cut the rows of `starts` (B, T) bool in front of every true value."""
    batch, frames = starts.shape
    heads = starts.clone()
    heads[:, 0] = True
    segment = heads.flatten().cumsum(0) - 1
    first = heads.flatten().nonzero().squeeze(1)
    offset = torch.arange(batch * frames, device=starts.device) - first[segment]
    lengths = torch.bincount(segment)
    by_length = lengths.argsort(descending=True, stable=True)
    rank = torch.empty_like(by_length)
    rank[by_length] = torch.arange(len(by_length), device=starts.device)
    order = (offset * len(lengths) + rank[segment]).argsort()
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order), device=starts.device)
    return Segments(
        order=order,
        place=place,
        sizes=torch.bincount(offset).cpu(),
        row=(first // frames)[by_length],
        fresh=starts.flatten()[first][by_length],
        last=rank[segment.view(batch, frames)[:, -1]],
    )


def pack(x: Tensor, segments: Segments) -> PackedSequence:
    """x (B, T, D) as a packed sequence of the segments."""
    return PackedSequence(x.flatten(0, 1)[segments.order], segments.sizes)


def unpack(packed: PackedSequence, segments: Segments, batch: int) -> Tensor:
    """The inverse of `pack`: (B, T, D)."""
    return packed.data[segments.place].view(batch, -1, packed.data.shape[-1])


def enter(state: Tensor, segments: Segments) -> Tensor:
    """(B, layers, D) -> (layers, S, D): the memory with which each segment begins."""
    return state[segments.row].masked_fill(segments.fresh[:, None, None], 0.0).transpose(0, 1).contiguous()


def leave(state: Tensor, segments: Segments) -> Tensor:
    """(layers, S, D) -> (B, layers, D): the memory with which each row ends."""
    return state[:, segments.last].transpose(0, 1)
