"""Depth-weighted sum pooling into a grid (eqs. 9-10) that never lifts the features.

    grid[v] = sum over (c, d, p) with cell v of  probability[c, d, p] * context[c, p]

The cell of every (camera c, depth bin d, pixel p) is known from the geometry, so the sum is one gather over
an index sorted by cell (torch's embedding_bag with per-sample weights), and so is the gradient of the
context, over an index sorted by pixel. No tensor of C x D x h x w x channels is ever made.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

_BLOCK = 1 << 12
"""Points whose features are gathered at once where no fused kernel exists."""
_INT32 = 1 << 31


class SplatIndex(NamedTuple):
    """The points that fall into the grid, in two orders. M points, V cells, P = C * h * w pixels."""

    entry: Tensor
    """(M,) flat index of the point's probability in (C, D, h * w), by cell."""
    pixel: Tensor
    """(M,) flat index of its context vector in (C, h * w), by cell."""
    cell: Tensor
    """(M,) its cell, rising."""
    cell_offsets: Tensor
    """(V,) where each cell's points begin."""
    entry_by_pixel: Tensor
    """(M,) as `entry`, sorted by pixel."""
    cell_by_pixel: Tensor
    """(M,) as `cell`, sorted by pixel."""
    pixel_offsets: Tensor
    """(P,) where each pixel's points begin."""


def build_index(cells: Tensor, count: int) -> SplatIndex:
    """Sort the points of a frustum.

    Args:
        cells: (C, D, h, w), the flat cell of each point, -1 for none.
        count: number of cells, V.

    Returns:
        The index as int32 where the numbers allow it: half the memory to read at each frame.
    """
    cameras, bins, h, w = cells.shape
    flat = cells.reshape(-1)
    entry = torch.nonzero(flat >= 0).squeeze(1)
    camera, pixel = entry // (bins * h * w), entry % (h * w)
    pixel = camera * (h * w) + pixel
    cell = flat[entry]
    by_cell, by_pixel = cell.argsort(stable=True), pixel.argsort(stable=True)
    index = SplatIndex(
        entry=entry[by_cell],
        pixel=pixel[by_cell],
        cell=cell[by_cell],
        cell_offsets=_offsets(cell, count),
        entry_by_pixel=entry[by_pixel],
        cell_by_pixel=cell[by_pixel],
        pixel_offsets=_offsets(pixel, cameras * h * w),
    )
    kind = _kind(max(len(flat), count))
    return SplatIndex(*(table.to(kind) for table in index))


def _offsets(keys: Tensor, count: int) -> Tensor:
    return torch.bincount(keys, minlength=count).cumsum(0) - torch.bincount(keys, minlength=count)


def _kind(numbers: int) -> torch.dtype:
    return torch.int32 if numbers < _INT32 else torch.int64


def splat(probability: Tensor, context: Tensor, index: SplatIndex) -> Tensor:
    """Pool every frame's features into the grid.

    Args:
        probability: (N, C * D * h * w), each pixel's distribution over depth.
        context: (N, C * h * w, channels).
        index: from `build_index`; one for all frames.

    Returns:
        (N, V, channels), differentiable in both.
    """
    grid: Tensor = _Splat.apply(probability, context, *index)
    return grid


class _Splat(torch.autograd.Function):
    """All frames in one gather: their context vectors, cells and points follow each other."""

    @staticmethod
    def forward(ctx: Any, probability: Tensor, context: Tensor, *parts: Tensor) -> Tensor:
        index = SplatIndex(*parts)
        ctx.save_for_backward(probability, context, *parts)
        frames, pixels, channels = context.shape
        points = len(index.pixel)
        kind = _kind(frames * max(points, pixels, len(index.cell_offsets)))
        rows = _per_frame(index.pixel, frames, pixels, kind)
        offsets = _per_frame(index.cell_offsets, frames, points, kind)
        weights = probability.index_select(1, index.entry).flatten()
        return weighted_bags(context.reshape(-1, channels), weights, rows, offsets).view(frames, -1, channels)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        probability, context, *parts = ctx.saved_tensors
        index = SplatIndex(*parts)
        frames, pixels, channels = context.shape
        cells, points = len(index.cell_offsets), len(index.pixel)
        kind = _kind(frames * max(points, pixels, cells))
        grad = grads[0].reshape(-1, channels)
        grad_probability = grad_context = None
        if ctx.needs_input_grad[0]:
            cell = _per_frame(index.cell, frames, cells, kind)
            rows = _per_frame(index.pixel, frames, pixels, kind)
            offsets = _per_frame(index.cell_offsets, frames, points, kind)
            products = paired_products(grad, context.reshape(-1, channels), rows, offsets, cell)
            grad_probability = torch.zeros_like(probability)
            grad_probability.index_copy_(1, index.entry.long(), products.view(frames, points))
        if ctx.needs_input_grad[1]:
            weights = probability.index_select(1, index.entry_by_pixel).flatten()
            rows = _per_frame(index.cell_by_pixel, frames, cells, kind)
            offsets = _per_frame(index.pixel_offsets, frames, points, kind)
            grad_context = weighted_bags(grad, weights, rows, offsets).view_as(context)
        return (grad_probability, grad_context, *(None for _ in parts))


def _per_frame(table: Tensor, frames: int, step: int, kind: torch.dtype) -> Tensor:
    """A table of numbers up to `step` -> the tables of all frames, each `step` above the one before.

    torch wants all the tables of a call in one type.
    """
    if frames == 1:
        return table
    kind = torch.promote_types(table.dtype, kind)
    shift = step * torch.arange(frames, dtype=kind, device=table.device)
    return (table + shift[:, None]).flatten()


def weighted_bags(table: Tensor, weights: Tensor, rows: Tensor, offsets: Tensor) -> Tensor:
    """out[b] = sum over the points m of bag b of weights[m] * table[rows[m]]: (bags, channels)."""
    if fused(table):
        return F.embedding_bag(rows, table, offsets, mode="sum", per_sample_weights=weights)
    ends = torch.cat([offsets[1:], offsets.new_tensor([len(rows)])])
    bags = torch.repeat_interleave(torch.arange(len(offsets), device=rows.device), ends - offsets)
    out = table.new_zeros(len(offsets), table.shape[1])
    for part in range(0, len(rows), _BLOCK):
        block = slice(part, part + _BLOCK)
        out.index_add_(0, bags[block], table[rows[block]] * weights[block, None])
    return out


def paired_products(grad: Tensor, context: Tensor, pixel: Tensor, offsets: Tensor, cell: Tensor) -> Tensor:
    """<grad[cell_m], context[pixel_m]> for every point m: (M,); the points are sorted by cell."""
    if fused(context):
        return torch.ops.aten._embedding_bag_per_sample_weights_backward(grad, context, pixel, offsets, cell, 0, -1)
    out = context.new_empty(len(cell))
    for part in range(0, len(out), _BLOCK):
        block = slice(part, part + _BLOCK)
        out[block] = (grad[cell[block]] * context[pixel[block]]).sum(-1)
    return out


def fused(table: Tensor) -> bool:
    """Whether torch's embedding_bag takes per-sample weights for this device and type."""
    return table.device.type in ("cpu", "cuda", "meta") and table.dtype in (torch.float32, torch.float64)
