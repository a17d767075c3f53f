"""A recipe with a perception stage over the fake plugins."""

from __future__ import annotations

from pathlib import Path

import pytest

STAGE = (
    "stages=[{kind: perception, steps: 96, envs: 2, rollout: 16, every: 4, pool: 16, uses: 2, minibatch: 4, workers: 1,"
    " held_out: 2, score_every: 64, checkpoint_every: 64, head_width: 8, learning_rate: 0.01}]"
)
OVERRIDES = ["spatial.name=tiny_grid", STAGE]


@pytest.fixture
def overrides() -> list[str]:
    """What makes the line recipe learn perception for three rounds."""
    return list(OVERRIDES)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Where a run will be kept."""
    return tmp_path / "run"
