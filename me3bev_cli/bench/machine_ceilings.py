"""The machine's ceilings as measured: how fast it multiplies matrices and reads memory at most."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

SIDE = {"cpu": 1024, "cuda": 8192}
"""Rows and columns of the matrices that are multiplied, by kind of device."""
READ_BYTES = {"cpu": 256 << 20, "cuda": 2 << 30}
"""Bytes that are read: more than caches hold."""
TRIES = 3
"""Of a sample; the fastest counts."""


class Ceilings:
    """Samples both rates with the threads that torch uses, in turns with what is compared.

    The read rate is that of main memory: what stays in a cache can be faster.
    """

    def __init__(self, device: torch.device, dtype: torch.dtype, side: int | None = None, read: int | None = None):
        self.device, self.dtype = device, dtype
        self.side = side or SIDE.get(device.type, 1024)
        generator = torch.Generator().manual_seed(0)
        self._a, self._b = (torch.randn(self.side, self.side, generator=generator).to(device, dtype) for _ in range(2))
        self._line = torch.ones((read or READ_BYTES.get(device.type, 256 << 20)) // 4, device=device)
        self.multiply: list[float] = []
        """FLOP/s of each sample."""
        self.read: list[float] = []
        """Bytes/s of each sample."""

    @torch.inference_mode()
    def sample(self) -> None:
        """Measure both rates once more."""
        self.multiply.append(2 * self.side**3 / self._fastest(lambda: torch.mm(self._a, self._b)))
        self.read.append(self._line.numel() * 4 / self._fastest(self._line.sum))

    def _fastest(self, work: Any) -> float:
        times = []
        for _ in range(TRIES):
            self._wait()
            begun = time.perf_counter()
            work()
            self._wait()
            times.append(time.perf_counter() - begun)
        return min(times)

    def _wait(self) -> None:
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)

    @property
    def flops_per_s(self) -> float:
        """Median over the samples."""
        return float(np.median(self.multiply))

    @property
    def bytes_per_s(self) -> float:
        """Median over the samples."""
        return float(np.median(self.read))

    def floor_ms(self, flops: int, read: int) -> float:
        """The least time for so many operations and bytes: the larger of the two, milliseconds."""
        return 1000 * max(flops / self.flops_per_s, read / self.bytes_per_s)

    def report(self) -> dict[str, Any]:
        """For `--json`."""
        return {
            "multiply_flops_per_s": self.flops_per_s,
            "read_bytes_per_s": self.bytes_per_s,
            "matrix_side": self.side,
            "read_bytes": self._line.numel() * 4,
            "samples": len(self.multiply),
            "spread": {
                "multiply_flops_per_s": [float(q) for q in np.percentile(self.multiply, [25, 75])],
                "read_bytes_per_s": [float(q) for q in np.percentile(self.read, [25, 75])],
            },
        }
