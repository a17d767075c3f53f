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
from me3bev_cli.perception.frames import Frames
from me3bev_cli.perception.losses import cell_weights
from me3bev_cli.perception.truth import classes_of, seen_in
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


class Pool:
    """The newest rounds of frames that fit, the newest of all in any case.

    Args:
        size: frames, at most.
        mirror: the camera that stands in for each one in a mirrored frame; None: frames are not mirrored.
        hidden: weight of far cells out of sight.
    """

    def __init__(self, size: int, mirror: Sequence[int] | None, hidden: float) -> None:
        self.size, self.hidden = size, hidden
        self.mirror = None if mirror is None else list(mirror)
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

    def batch(self, chosen: NDArray[np.int64], turned: NDArray[np.bool_], device: torch.device) -> Batch:
        """Frames of the pool by number; those that are `turned` are mirrored, where that is possible."""
        parts = []
        for number, turn in zip(chosen, turned, strict=True):
            frames, i = self._at[number]
            frame = frames.images[i], frames.maps[i], frames.depth[i]
            parts.append(mirrored(*frame, self.mirror) if turn and self.mirror is not None else frame)
        images, maps, depth = (np.stack(part) for part in zip(*parts, strict=True))
        seen = to_device(seen_in(maps), device)
        return Batch(
            images=to_device(images, device),
            truth=to_device(classes_of(maps), device).long(),
            cells=cell_weights(seen, self.hidden, NEAR),
            depth=to_device(depth, device).float() / 255,
        )


def _count(drawn: list[Frames]) -> int:
    return sum(len(frames) for frames in drawn)


Bytes = NDArray[np.uint8]


def mirrored(images: Bytes, maps: Bytes, depth: Bytes, cameras: list[int]) -> tuple[Bytes, Bytes, Bytes]:
    """A frame of the world with left and right exchanged."""
    return images[cameras, ..., ::-1], maps[..., ::-1], depth[cameras, ..., ::-1]
