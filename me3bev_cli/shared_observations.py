"""Observations of several environments in shared memory: written by worker processes, read by their parent."""

from __future__ import annotations

from collections.abc import Mapping
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Frames = dict[str, NDArray[Any]]

ALIGNMENT = 64
"""Bytes: every array begins on a cache line."""


class SharedObservations:
    """For each of N environments its newest observation and the last one of the episode before.

    `newest` and `last` map the keys of a dict observation to arrays (N, ...). The memory lives as long as a process
    holds it: once everybody has attached to it by name, `forget_name` leaves nothing that could stay behind.

    Args:
        space: of one environment's observation, boxes by key.
        count: N.
        name: of the memory to attach to; None makes new memory, all zeros.
    """

    def __init__(self, space: spaces.Dict, count: int, name: str | None = None) -> None:
        if not isinstance(space, spaces.Dict):
            raise TypeError(f"observations must be a dict of arrays, not {space}")
        offsets, size = {}, 0
        for key, part in space.spaces.items():
            if part.shape is None or part.dtype is None:
                raise TypeError(f"observation {key!r} is no array: {part}")
            offsets[key] = size
            size += -(-2 * count * part.dtype.itemsize * int(np.prod(part.shape)) // ALIGNMENT) * ALIGNMENT
        self._memory = SharedMemory(name, create=name is None, size=size if name is None else 0)
        self.name = self._memory.name
        self.newest: Frames = {}
        self.last: Frames = {}
        for key, part in space.spaces.items():
            assert part.shape is not None
            both = np.ndarray((2, count, *part.shape), part.dtype, self._memory.buf, offsets[key])
            self.newest[key], self.last[key] = both

    def write(self, slot: Frames, index: int, observation: Mapping[str, Any]) -> None:
        """Put an environment's observation into `newest` or `last`."""
        for key, array in slot.items():
            array[index] = observation[key]

    def copy(self, target: Frames, rows: slice) -> None:
        """Copy the newest observations to some rows of larger arrays."""
        for key, array in self.newest.items():
            target[key][rows] = array

    def forget_name(self) -> None:
        """Let the memory vanish with its last holder. Nobody can attach to it any more."""
        self._memory.unlink()

    def close(self) -> None:
        """Let go of the memory; may be called twice."""
        self.newest.clear()
        self.last.clear()
        self._memory.close()
