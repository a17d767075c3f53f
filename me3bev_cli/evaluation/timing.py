"""Where an evaluation's time went: simulator, network, everything else. Kept apart from the results, which repeat."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.output import write_json


@dataclass
class Timing:
    """Seconds that processes were at work, summed over all of them."""

    simulator: float = 0.0
    """Making, resetting and stepping environments, their cameras included."""
    network: float = 0.0
    """Deciding, the way of the observations to the device and back included."""
    busy: float = 0.0
    """On jobs, from beginning to end."""
    loading: float = 0.0
    """Of that, loading libraries, maps and policies, and the picture of one instant."""
    steps: int = 0
    episodes: int = 0

    def add(self, other: Timing) -> None:
        """Sum up."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    @contextmanager
    def spent(self, on: str) -> Iterator[None]:
        """Count the time inside."""
        start = time.perf_counter()
        try:
            yield
        finally:
            setattr(self, on, getattr(self, on) + time.perf_counter() - start)

    def shares(self) -> dict[str, float]:
        """Of the time after loading: simulator, network and rest, which sum to 1; empty when nothing was driven."""
        driving = self.busy - self.loading
        if driving <= 0 or not self.steps:
            return {}
        simulator, network = self.simulator / driving, self.network / driving
        return {"simulator": simulator, "network": network, "rest": max(0.0, 1.0 - simulator - network)}


def pace(timing: Timing, seconds: float, workers: int) -> str:
    """How long it took, for people."""
    if not timing.steps:
        return "nothing was left to drive"
    crew = "this process" if workers == 0 else f"{workers} worker{'s' if workers > 1 else ''}"
    shares = ", ".join(f"{name} {share:.0%}" for name, share in timing.shares().items())
    return f"{timing.steps:,} steps in {seconds:.1f} s ({timing.steps / seconds:.0f} per s), {crew}: {shares}"


def note(path: Path, timing: Timing, seconds: float, workers: int) -> None:
    """Append a sitting to the file of timings: an evaluation may be driven in several."""
    sitting = {
        "workers": workers,
        "seconds": seconds,
        "episodes": timing.episodes,
        "steps": timing.steps,
        "steps_per_second": timing.steps / seconds if seconds > 0 else None,
        "worker_seconds": {
            "simulator": timing.simulator,
            "network": timing.network,
            "rest": timing.busy - timing.loading - timing.simulator - timing.network,
            "loading": timing.loading,
            "starting_and_waiting": max(1, workers) * seconds - timing.busy,
        },
        "shares": timing.shares(),
    }
    write_json({"sittings": [*_earlier(path), sitting]}, str(path))


def _earlier(path: Path) -> list[Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))["sittings"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return found if isinstance(found, list) else []
