"""`LogDataset`: a folder of logs as a torch dataset of frames, or of sequences of frames that follow each other."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from me3bev_cli.errors import LogError
from me3bev_cli.recording.calibration import refuse_mixed
from me3bev_cli.recording.frames import TRAINING_PARTS, FrameLog
from me3bev_cli.recording.mapping import TopicMapping
from me3bev_cli.recording.reader import log_files

OPEN_FILES = 16
"""Logs that each process keeps open; of each, a few chunks stay in memory."""
TENSOR_PARTS = (*TRAINING_PARTS, "pose", "depth", "semantics")
"""What an item may hold: what has the same shape in every frame."""


class LogDataset(Dataset[dict[str, torch.Tensor]]):
    """Frames by number, over all logs in the order of their names. Works with any number of DataLoader workers.

    Where frames lie is read from the files' own indices, once, when the dataset is made; an item reads the one chunk
    or two that hold it.

    Args:
        source: a folder, a file, or several files.
        length: T, frames of a sequence; None gives single frames, without the axis T.
        stride: frames between the beginnings of two sequences (or between two frames).
        parts: of `TENSOR_PARTS`; by default `TRAINING_PARTS`, or what the mapping names of them.
        mapping: topics of logs that are not ours.

    Raises:
        LogError: there is no log; one is damaged, lacks topics or has other cameras or another calibration than the
            first; no log is as long as a sequence.
    """

    def __init__(
        self,
        source: Path | Sequence[Path],
        length: int | None = None,
        stride: int = 1,
        parts: Sequence[str] | None = None,
        mapping: TopicMapping | None = None,
    ) -> None:
        if (length is not None and length < 1) or stride < 1:
            raise LogError(f"sequences of {length} frames, {stride} apart", allowed="1 or more")
        for part in parts or ():
            if part not in TENSOR_PARTS:
                raise LogError(f"an item has no part '{part}'", allowed=", ".join(TENSOR_PARTS))
        paths = log_files(source) if isinstance(source, Path) else list(source)
        self.length, self.stride = length, stride
        self.logs = [_indexed(path, parts, mapping) for path in paths]
        refuse_mixed(self.logs)
        per_item = length or 1
        counts = [max(0, (len(log) - per_item) // stride + 1) for log in self.logs]
        self._ends = np.cumsum(counts)
        if not self._ends.size or not self._ends[-1]:
            longest = max((len(log) for log in self.logs), default=0)
            raise LogError(f"no log is as long as a sequence of {per_item} frames", hint=f"The longest has {longest}")
        self._open: OrderedDict[int, FrameLog] = OrderedDict()

    @property
    def parts(self) -> tuple[str, ...]:
        """What an item holds."""
        return self.logs[0].parts

    def __len__(self) -> int:
        return int(self._ends[-1])

    def where(self, index: int) -> tuple[int, int]:
        """(number of the log, number of its first frame) of an item. Raises IndexError beyond the last."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"item {index} of {len(self)}")
        index %= len(self)
        log = int(np.searchsorted(self._ends, index, side="right"))
        before = int(self._ends[log - 1]) if log else 0
        return log, (index - before) * self.stride

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        """An item: images (C, 3, H, W) uint8, bev (X, Y) uint8, vectors float32, numbers (), each with T before it in
        a sequence.

        Raises:
            LogError: a frame is damaged.
        """
        number, first = self.where(index)
        log = self._opened(number)
        if self.length is None:
            return {part: torch.as_tensor(_array(value)) for part, value in log.frame(first).items()}
        frames = [log.frame(first + i) for i in range(self.length)]
        return {part: torch.from_numpy(np.stack([_array(f[part]) for f in frames])) for part in self.parts}

    def _opened(self, number: int) -> FrameLog:
        """A log, with its file open; the one that was not used for longest is closed."""
        log = self.logs[number]
        self._open[number] = log
        self._open.move_to_end(number)
        while len(self._open) > OPEN_FILES:
            _, oldest = self._open.popitem(last=False)
            oldest.close()
        return log

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_open": OrderedDict()}


def _indexed(path: Path, parts: Sequence[str] | None, mapping: TopicMapping | None) -> FrameLog:
    log = FrameLog(path, parts, mapping)
    log.close()
    return log


def _array(value: Any) -> Any:
    """As an array that torch may own: what was read from a file's bytes cannot be written to."""
    array = np.asarray(value, np.float32 if isinstance(value, float) else None)
    return array if array.flags.writeable else array.copy()
