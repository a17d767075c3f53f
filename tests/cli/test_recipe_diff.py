"""`me3bev recipe diff`: which keys differ, whatever the recipes are named by."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from me3bev_cli.main import app
from me3bev_cli.recipe_diff import ABSENT, differences, flatten, shown


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["recipe", "diff", *arguments])


def test_blocks_are_compared_key_by_key_and_plain_lists_as_a_whole() -> None:
    one = {"a": {"b": 1, "c": [1, 2]}, "stages": [{"kind": "ppo", "steps": 5}], "seed": 0}
    other = {"a": {"b": 1, "c": [1, 3], "d": None}, "stages": [{"kind": "ppo", "steps": 6}, {"kind": "x"}], "seed": 0}
    assert flatten(one) == {"a.b": 1, "a.c": [1, 2], "stages.0.kind": "ppo", "stages.0.steps": 5, "seed": 0}
    assert [(d.key, d.values) for d in differences([one, other])] == [
        ("a.c", ([1, 2], [1, 3])),
        ("a.d", (ABSENT, None)),
        ("stages.0.steps", (5, 6)),
        ("stages.1.kind", (ABSENT, "x")),
    ]
    assert differences([one, one]) == []
    assert [shown(v) for v in (ABSENT, None, True, [1, None], {"a": False})] == [
        "–", "null", "true", "[1, null]", "{a: false}",
    ]  # fmt: skip


def test_stages_are_compared_with_those_of_their_kind() -> None:
    one = {"stages": [{"kind": "perception", "steps": 9, "pool": 1}, {"kind": "ppo", "steps": 5, "envs": 8}]}
    other = {"stages": [{"kind": "ppo", "steps": 2, "envs": 8}, {"kind": "ppo", "steps": 6, "envs": 8}]}
    assert [(d.key, d.values) for d in differences([one, other])] == [
        ("stages.perception[-1].steps", (9, ABSENT)),
        ("stages.ppo[-1].steps", (5, 6)),
        ("stages.ppo[-2].steps", (ABSENT, 2)),
    ]


def test_the_ablations_differ_in_what_is_compared() -> None:
    found = json.loads(run("small/me3bev", "small/me3bev_without_ssa", "--json", "-").stdout)["differences"]
    keys = [d["key"] for d in found]
    assert {key.partition(".")[0] for key in keys} == {"name", "spatial", "stages"}
    assert [key for key in keys if key.startswith("stages")] == [
        "stages.perception[-1].steps", "stages.imitation[-1].freeze", "stages.ppo[-1].steps", "stages.ppo[-1].freeze",
    ]  # fmt: skip


def test_names_files_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ME3BEV_RUNS", str(tmp_path / "all"))
    Path("mine.yaml").write_text("extends: small\nseed: 7\n")
    # A run of another version: its keys are compared as they stand.
    Path("all/old").mkdir(parents=True)
    Path("all/old/recipe.yaml").write_text("name: old\nseed: 7\nforgotten: {key: 1}\n")
    result = run("small", "mine.yaml", "--json", "-")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["differences"] == [
        {"key": "name", "values": ["small", "mine"], "there": [True, True]},
        {"key": "seed", "values": [0, 7], "there": [True, True]},
    ]
    assert "seed" in run("small", "mine.yaml").stdout
    assert run("small", "small").stdout == "no key differs\n"
    rows = {d["key"]: d for d in json.loads(run("mine.yaml", "old", "--json", "-").stdout)["differences"]}
    assert "seed" not in rows
    assert rows["forgotten.key"] == {"key": "forgotten.key", "values": [None, 1], "there": [False, True]}


def test_what_is_no_recipe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    unknown = run("small", "smal")
    assert (unknown.exit_code, "unknown recipe 'smal'; did you mean 'small'?" in unknown.stderr) == (2, True)
    empty = run("small", str(tmp_path))
    assert (empty.exit_code, "holds no recipe.yaml. Name a run" in empty.stderr) == (2, True)
