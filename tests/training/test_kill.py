"""A run that is killed goes on as if nothing had been: the same weights, bit for bit, and the same log."""

from __future__ import annotations

from pathlib import Path

from fakes import install_for_good

from me3bev_cli.training.kill_check import KillCheck


def test_killed_runs_end_as_undisturbed_ones(line_recipe: Path, tmp_path: Path) -> None:
    said: list[str] = []
    overrides = ["stages.0.steps=160", "stages.0.checkpoint_every=32"]
    check = KillCheck(str(line_recipe), overrides, tmp_path, 0, install_for_good, said.append)
    outcome = check.run(3)
    assert outcome.kills, said
    assert outcome.same_weights, said
    assert outcome.same_rows, said
