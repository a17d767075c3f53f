"""The convergence figure: moving averages, seeds joined, plateaus worked by hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.training.convergence import groups, moving_average, reached, sentences


def make(run: Path, rewards: Sequence[float | None], seed: int = 0, name: str = "mine", **more: Any) -> Path:
    """A run folder of 100 steps per update; a None is an update of another kind of stage."""
    run.mkdir(parents=True)
    recipe = {"name": name, "seed": seed, "stages": [{"kind": "ppo", "steps": 1000}]} | more
    (run / "recipe.yaml").write_text(json.dumps(recipe))
    rows = []
    for index, reward in enumerate(rewards):
        row: dict[str, Any] = {"steps": 100 * (index + 1), "stage_steps": 0, "stage": 1, "kind": "ppo"}
        row |= {"stage": 0, "kind": "perception", "loss": 1.0} if reward is None else {"reward_per_step": reward}
        rows.append(json.dumps(row))
    (run / "metrics.jsonl").write_text("\n".join(rows) + "\n")
    return run


def test_the_moving_average() -> None:
    assert moving_average(np.array([1.0, 2.0, 3.0, 7.0]), 2).tolist() == [1.0, 1.5, 2.5, 5.0]
    assert moving_average(np.array([1.0, 2.0]), 10).tolist() == [1.0, 1.5]


def steps(count: int) -> Any:
    return 100.0 * np.arange(1, count + 1)


def test_ninety_per_cent_of_a_positive_plateau() -> None:
    # 0, 1, ..., 10, then 10 for good: 9 is 0.9 of the plateau and stands at the tenth update.
    smooth = np.array([*range(11), *[10] * 30], float)
    found = reached(steps(len(smooth)), smooth)
    assert (found.plateau, found.threshold, found.step, found.rising) == (10.0, 9.0, 1000, False)


def test_a_negative_plateau_is_approached_from_the_first_value() -> None:
    # From -20 to -10: nine tenths of the way is -11. (0.9 times -10 would be above the plateau.)
    smooth = np.array([*range(-20, -10), *[-10] * 30], float)
    found = reached(steps(len(smooth)), smooth)
    assert (found.plateau, found.threshold, found.step) == (-10.0, -11.0, 1000)


def test_a_curve_that_still_rises_says_so() -> None:
    found = reached(steps(100), np.arange(100.0))
    assert found.rising
    # The last tenth, 11 updates from 9,010 on: 90 to 99 has the mean 94.5; 0.9 of it is 85.05, first passed by 86.
    assert (found.plateau, found.step) == (94.5, 8700)


def test_a_curve_that_falls_reaches_nothing() -> None:
    found = reached(steps(50), np.linspace(5, 1, 50))
    assert found.step is None
    assert not found.rising


def test_one_value_is_no_convergence() -> None:
    assert reached(np.array([100.0]), np.array([3.0])).step is None


def test_seeds_become_one_line(tmp_path: Path) -> None:
    one = make(tmp_path / "a", [0, 2, 4, 6], seed=0)
    two = make(tmp_path / "b", [2, 4, 6], seed=1)
    other = make(tmp_path / "c", [1, 1], policy="another")
    found = groups([one, two, other], 1)
    assert [group.label for group in found] == ["mine (a)", "mine (c)"]
    first = found[0]
    # Only where both have values.
    assert first.steps.tolist() == [100, 200, 300]
    assert first.mean.tolist() == [1, 3, 5]
    assert (first.low.tolist(), first.high.tolist()) == ([0, 2, 4], [2, 4, 6])


def test_steps_of_earlier_stages_shift_the_curve(tmp_path: Path) -> None:
    run = make(tmp_path / "a", [None, None, 1, 5, 5, 5, 5, 5])
    (group,) = groups([run], 1)
    assert group.steps[0] == 300
    assert group.curves[0].before == ("perception",)
    assert sentences(group) == [
        "mine: 90 % of its plateau (5 per step) first at step 400",
        "  the curve begins at step 300, after perception",
    ]


def test_the_command_draws_and_tells(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ME3BEV_RUNS", str(tmp_path / "runs"))
    make(tmp_path / "runs" / "batch" / "x0", [0, 5, 10, 10, 10, 10], seed=0)
    make(tmp_path / "runs" / "batch" / "x1", [0, 0, 10, 10, 10, 10], seed=1)
    make(tmp_path / "runs" / "empty", [])
    arguments = ["plot", "batch", "empty", "--out", str(tmp_path / "c.png"), "--window", "1", "--json", "-"]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
    (group,) = json.loads(result.stdout)["groups"]
    assert (group["label"], group["plateau"], group["reaches_90_percent_at"]) == ("mine", 10, 300)
    assert [run["seed"] for run in group["runs"]] == [0, 1]
    assert "mine: 90 % of its plateau (10 per step) first at step 300 (mean of 2 runs)" in result.stderr
    assert "empty has no reward yet and is left out" in result.stderr


def test_nothing_to_draw_is_a_mistake(tmp_path: Path) -> None:
    make(tmp_path / "empty", [])
    result = CliRunner().invoke(app, ["plot", str(tmp_path / "empty"), "--out", str(tmp_path / "c.png")])
    assert result.exit_code == 2
    assert "there is nothing to draw" in result.stderr
    assert not (tmp_path / "c.png").exists()
    result = CliRunner().invoke(app, ["plot", str(tmp_path / "nowhere")])
    assert "nowhere is not a run folder" in result.stderr
