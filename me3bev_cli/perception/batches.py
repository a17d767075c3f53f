"""A pool of the last rounds' frames, and minibatches of it as tensors."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from me3bev_cli.decoding.scores import NEAR
from me3bev_cli.perception.augment import Change, changed, outside
from me3bev_cli.perception.frames import Frames
from me3bev_cli.perception.losses import cell_weights
from me3bev_cli.perception.truth import CELLS, classes_of, seen_in
from me3bev_cli.pipeline.transfer import to_device


class Batch(NamedTuple):
    """B frames on the network's device."""

    images: Tensor
    """(B, C, 3, H, W) uint8"""
    truth: Tensor
    """(B, 200, 200) int64"""
    cells: Tensor
    """(B, 200, 200), how much each cell counts."""
    depth: Tensor
    """(B, C, bins, h, w), shares; no bins where depth is not learned."""
    stretch: Tensor | None
    """(B, 2, X), where the rows and columns of the grid are taken from, from -1 to 1; None: from where they are."""


class Pool:
    """The newest rounds of frames that fit, the newest of all in any case.

    Args:
        size: frames, at most.
        mirror: the camera that stands in for each one in a mirrored frame; None: frames are not mirrored.
        hidden: weight of far cells out of sight.
        grid: cells per side of the grid that may be stretched.
    """

    def __init__(self, size: int, mirror: Sequence[int] | None, hidden: float, grid: int) -> None:
        self.size, self.hidden, self.grid = size, hidden, grid
        self.mirror = [] if mirror is None else list(mirror)
        self.rounds: deque[list[Frames]] = deque()
        self._at: list[tuple[Frames, int]] = []

    def add(self, drawn: list[Frames]) -> None:
        """Take in a round; older ones go where it gets too much."""
        self.rounds.append(drawn)
        while len(self.rounds) > 1 and sum(_count(old) for old in self.rounds) > self.size:
            self.rounds.popleft()
        self._at = [(frames, i) for old in self.rounds for frames in old for i in range(len(frames))]

    def __len__(self) -> int:
        return len(self._at)

    def batch(self, chosen: NDArray[np.int64], changes: Sequence[Change], device: torch.device) -> Batch:
        """Frames of the pool by number, each after a change."""
        parts = []
        for number, change in zip(chosen, changes, strict=True):
            frames, i = self._at[number]
            parts.append(changed(frames.images[i], frames.maps[i], frames.depth[i], change, self.mirror))
        images, maps, depth = (np.stack(part) for part in zip(*parts, strict=True))
        cells = cell_weights(to_device(seen_in(maps), device), self.hidden, NEAR)
        return Batch(
            images=to_device(images, device),
            truth=to_device(classes_of(maps), device).long(),
            cells=cells * to_device(_inside(changes), device),
            depth=to_device(depth, device).float() / 255,
            stretch=self._stretch(changes, device),
        )

    def _stretch(self, changes: Sequence[Change], device: torch.device) -> Tensor | None:
        if not any(change.stretch for change in changes):
            return None
        plain = np.tile((np.arange(self.grid) + 0.5) * 2 / self.grid - 1, (2, 1))
        axes = [plain if change.stretch is None else change.stretch.sources(self.grid) for change in changes]
        return to_device(np.array(axes, np.float32), device)


def _inside(changes: Sequence[Change]) -> NDArray[np.bool_]:
    """(B, 200, 200): cells whose truth is known."""
    known = np.ones((len(changes), CELLS, CELLS), bool)
    for cells, change in zip(known, changes, strict=True):
        if change.stretch is not None:
            cells[outside(change.stretch)] = False
    return known


def _count(drawn: list[Frames]) -> int:
    return sum(len(frames) for frames in drawn)
