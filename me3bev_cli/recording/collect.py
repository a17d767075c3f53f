"""Drives episodes and records each as one MCAP file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import Rig
from me3bev_cli.recording.writer import EpisodeWriter

Act = Callable[[Mapping[str, NDArray[Any]], Any], NDArray[np.float32]]
"""(observation, environment) -> action."""


def episode_path(folder: Path, place: str, density: str, index: int) -> Path:
    """The file of an episode: its name says which one it is."""
    return folder / f"{place}-{density}-{index:05d}.mcap"


def record_episode(
    env: Any, rig: Rig, act: Act, path: Path, metadata: Mapping[str, str], *, seed: int, quality: int
) -> int:
    """Drive one episode and write it; returns its number of steps."""
    observation, _ = env.reset(seed=seed)
    steps, done = 0, False
    with EpisodeWriter(path, rig, {**metadata, "seed": str(seed)}, quality) as writer:
        while not done:
            bev = env.unwrapped.bev_semantics()
            action = act(observation, env)
            after, _, terminated, truncated, info = env.step(action)
            record = info["record"]
            writer.add(observation, action, record, bev, (record["x"], record["y"], record["heading"]))
            observation, done = after, terminated or truncated
            steps += 1
    return steps
