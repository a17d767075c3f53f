"""From arrays to tensors on a device. To CUDA they go through pinned memory, while the CPU works on.

torch's allocator of pinned memory hands a block out again only when the copies that were begun from it are done.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


def to_device(array: NDArray[Any], device: torch.device) -> torch.Tensor:
    """An array in its own type on `device`; on the CPU the tensor shares the array's memory."""
    tensor = torch.as_tensor(np.ascontiguousarray(array))
    if device.type != "cuda":
        return tensor.to(device)
    return tensor.pin_memory().to(device, non_blocking=True)


def to_tensors(observation: Mapping[str, NDArray[Any]], device: torch.device) -> dict[str, torch.Tensor]:
    """Arrays with a leading batch axis -> tensors on `device`, in their own types (images stay uint8)."""
    return {key: to_device(value, device) for key, value in observation.items()}


def gather(array: NDArray[Any], rows: NDArray[np.int64], device: torch.device) -> torch.Tensor:
    """`array[rows]` on `device`, copied once on its way: for CUDA straight into pinned memory.

    Args:
        array: (N, ...), contiguous.
        rows: (M,), each in 0 .. N - 1.
    """
    if device.type != "cuda":
        return torch.as_tensor(np.take(array, rows, axis=0)).to(device)
    kind = torch.as_tensor(array[:0]).dtype
    staging = torch.empty((len(rows), *array.shape[1:]), dtype=kind, pin_memory=True)
    # Any mode but the default one writes into `out` itself.
    np.take(array, rows, axis=0, out=staging.numpy(), mode="clip")
    return staging.to(device, non_blocking=True)
