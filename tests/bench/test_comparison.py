"""`make comparison`: what it would run, how it goes on, and what it keeps."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from me3bev_cli.bench import comparison
from me3bev_cli.bench.comparison import COSTS, SCRATCH, main, parts, run_of
from me3bev_cli.bench.comparison_results import write_results
from me3bev_cli.main import app
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.training.run import make_run

METHODS = (comparison.FIRST, *comparison.FLAT, *comparison.LOOKING)


def test_all_methods_have_the_same_budget_world_and_reward() -> None:
    recipes = {name: resolve_recipe(name) for name in (*METHODS, *SCRATCH)}
    assert {sum(stage.steps for stage in recipe.stages) for recipe in recipes.values()} == {94_208}
    first = recipes[comparison.FIRST]
    for recipe in recipes.values():
        assert (recipe.simulator, recipe.observation, recipe.weather) == (
            first.simulator,
            first.observation,
            first.weather,
        )
        assert (recipe.evaluation, recipe.seed) == (first.evaluation, first.seed)
    # Whoever starts without a driver to copy is charged less for a red light: one reward within each table.
    for table in (METHODS, SCRATCH):
        assert len({str(recipes[name].reward) for name in table}) == 1
    cloned = [[s for s in recipes[name].stages if s.kind == "imitation"] for name in METHODS]
    assert {(s.steps, s.epochs, s.minibatch, s.busiest_of, s.reward_scale) for (s,) in cloned} == {
        (20_480, 6, 128, 8, 0.005)
    }
    driven = [stage for name in METHODS for stage in recipes[name].stages if stage.kind == "ppo"]
    assert len({(str(stage.guidance), stage.epochs, stage.reward_scale) for stage in driven}) == 1
    assert not any(stage.kind == "imitation" for name in SCRATCH for stage in recipes[name].stages)
    explored = [stage for name in SCRATCH for stage in recipes[name].stages if stage.kind == "ppo"]
    assert {(s.simulator.get("collision_penalty"), s.reward_scale, s.epochs) for s in explored} == {(200, 0.02, 4)}


def test_each_part_is_a_command_that_exists(tmp_path: Path) -> None:
    for part in parts(tmp_path, 2):
        # Unknown options are told before anything is looked for.
        result = CliRunner().invoke(app, [*part.words, "--no-such-option"])
        assert "No such option: --no-such-option" in result.stderr, part.command
        assert part.seconds > 0


def test_eyes_are_trained_once_for_each_seed(tmp_path: Path) -> None:
    first, others, second, scratch, *_ = parts(tmp_path, 2)
    eyes = str(run_of(tmp_path, comparison.FIRST))
    assert first.makes == (Path(eyes),)
    # OMP_NUM_THREADS is 1 for all parts: what runs alone says how many it wants.
    assert first.words[first.words.index("--threads") + 1] == "2"
    for part in (others, scratch):
        assert part.words[part.words.index("--perception") + 1] == eyes
    assert "--perception" not in second.words
    more = parts(tmp_path, 4)
    assert [part.seconds for part in more[1:2]] == [pytest.approx(others.seconds / 2)]
    assert first.seconds == pytest.approx(COSTS["perception"] / 2 + COSTS["looking"])


def test_it_says_first_how_long_it_takes_and_leaves_out_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = run_of(tmp_path, comparison.FIRST)
    make_run(run, "name: small-me3bev\n")
    assert not parts(tmp_path, 2)[0].done
    (run / "summary.json").write_text("{}")
    typed: list[tuple[str, ...]] = []

    def ran(words: tuple[str, ...], env: dict[str, str]) -> subprocess.CompletedProcess[bytes]:
        assert env["OMP_NUM_THREADS"] == "1"
        typed.append(words[3:])
        return subprocess.CompletedProcess(words, 0 if len(typed) < 3 else 130)

    monkeypatch.setattr(comparison.subprocess, "run", ran)
    assert main(["--out", str(tmp_path), "--plan"]) == 0
    assert typed == []
    assert main(["--out", str(tmp_path)]) == 130
    found = capsys.readouterr()
    assert "perception and the first policy: done" in found.out
    assert "left: about" in found.out
    assert "stopped in 'ppo from scratch'; the same command goes on" in found.err
    assert [words[0] for words in typed] == ["train", "train", "train"]
    assert "small/me3bev_gru" in typed[0]


def test_flat_policies_are_evaluated_sooner_from_scratch_too(tmp_path: Path) -> None:
    (scratch,) = [part for part in parts(tmp_path, 1, episodes=1) if part.name == "the table from scratch"]
    each = 2 * COSTS["episode"] + (2 + comparison.REFERENCES) * COSTS["flat episode"]
    assert scratch.seconds == pytest.approx(comparison.CELLS * each)


def test_a_table_of_other_episodes_is_driven_again_and_the_page_is_made_of_the_new_one(tmp_path: Path) -> None:
    def done(name: str, episodes: int) -> bool:
        return {part.name: part.done for part in parts(tmp_path, 2, episodes)}[name]

    table, page = tmp_path / "eval" / "results.json", tmp_path / "report" / "index.html"
    for path in (table, page):
        path.parent.mkdir()
    table.write_text(json.dumps({"episodes": 25}))
    page.write_text("<html>")
    os.utime(page, ns=(table.stat().st_mtime_ns,) * 2)
    assert done("the table", 25)
    assert not done("the table", 100)
    assert done("the page", 25)
    os.utime(page, ns=(table.stat().st_mtime_ns - 1,) * 2)
    assert not done("the page", 25)


def row(method: str, place: str, metric: str, mean: float) -> dict[str, Any]:
    ends = {"low": mean - 0.01, "high": mean + 0.01, "n": 100}
    return {"method": method, "map": place, "density": "low", "metric": metric, "mean": mean, **ends}


def test_what_is_kept_is_small_and_whole(tmp_path: Path) -> None:
    metrics = ("collision_rate", "comfort")
    rows = [row("a", place, name, 1 / 3) for place in ("T1", "average") for name in metrics]
    one = {"method": "a", "map": "average", "density": "low", "metric": "comfort", "difference": 0.1, "low": 0.0}
    compared = one | {"high": 0.2, "improvement": 0.7, "n": 100, "verdict": "better", "significant": True}
    document = {
        "maps": ["T1"], "methods": [{"method": "a", "recipe": "small-a", "checkpoint": "step_1", "identity": {}}],
        "rows": rows, "baseline": "b", "comparisons": [compared, compared | {"map": "T1"}],
    }  # fmt: skip
    (tmp_path / "eval").mkdir()
    (tmp_path / "eval" / "results.json").write_text(json.dumps(document))
    (tmp_path / "eval" / "results.csv").write_text("csv")
    run = tmp_path / "small-a-seed0"
    make_run(run, "name: small-a\n")
    (run / "summary.json").write_text(json.dumps({"recipe": "small-a", "seed": 0, "steps": 9, "seconds": 1.23456}))
    (run / "metrics.jsonl").write_text(
        json.dumps({"steps": 4, "eval_score": 80.0, "eval_collision_rate": 0.1, "eval_completion": 0.9}) + "\n"
    )
    unfinished = tmp_path / "small-b-seed0"
    make_run(unfinished, "name: small-b\n")
    written = write_results(tmp_path, tmp_path / "kept", {"the table": "me3bev eval"})
    assert [path.name for path in written] == ["comparison.json", "table.csv"]
    found = json.loads(written[0].read_text())
    assert found["commands"] == {"the table": "me3bev eval"}
    table = found["imitation_start"]
    assert [(r["metric"], r["mean"]) for r in table["averages"]] == [("collision_rate", 0.3333), ("comfort", 0.3333)]
    assert [r["metric"] for r in table["by_map"]] == ["collision_rate"]
    assert [(c["metric"], c["verdict"]) for c in table["paired_differences"]] == [("comfort", "better")]
    (trained,) = found["training"]
    assert (trained["seconds"], trained["evaluations"][0]["driving_score"]) == (1.2346, 80.0)
