"""Thresholds: what they judge, what is wrong with a file, and the exit code."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from me3bev_cli.errors import RecipeError, UserError
from me3bev_cli.evaluation.gate import check_names, read_gate, shortfalls
from me3bev_cli.evaluation.summary import AVERAGE, Row


def gate_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "gate.yaml"
    path.write_text(text)
    return path


ROWS = [
    Row("me", "T1", "low", "driving_score", 60.0, 50.0, 70.0, 9),
    Row("me", "T2", "low", "driving_score", 20.0, 10.0, 30.0, 9),
    Row("me", AVERAGE, "low", "driving_score", 40.0, 30.0, 50.0, 18),
    Row("me", AVERAGE, "high", "driving_score", 35.0, 25.0, 45.0, 18),
    Row("me", AVERAGE, "low", "collision_rate", 0.25, 0.2, 0.3, 18),
    Row("me", AVERAGE, "low", "comfort", math.nan, math.nan, math.nan, 0),
    Row("idle", AVERAGE, "low", "driving_score", 0.0, 0.0, 0.0, 18),
]


@pytest.mark.parametrize(
    ("threshold", "texts"),
    [
        ("{metric: driving_score, at_least: 35}", []),
        ("{metric: driving_score, at_least: 36}", ["me, average, high: driving_score is 35, should be at least 36"]),
        ("{metric: driving_score, at_least: 36, density: low}", []),
        ("{metric: driving_score, at_least: 30, map: T2}", ["me, T2, low: driving_score is 20, should be at least 30"]),
        (
            "{metric: driving_score, at_least: 36, figure: low, density: low}",
            ["me, average, low: driving_score (low end of the interval) is 30, should be at least 36"],
        ),
        (
            "{metric: driving_score, at_least: 10, method: idle}",
            ["idle, average, low: driving_score is 0, should be at least 10"],
        ),
        (
            "{metric: collision_rate, at_most: 0.2}",
            ["me, average, low: collision_rate is 0.25, should be at most 0.2"],
        ),
        ("{metric: collision_rate, at_most: 0.25, at_least: 0.25, version: 1}", []),
        ("{metric: comfort, at_least: 0.1}", ["me, average, low: comfort: there is no figure, from 0 episodes"]),
        ("{metric: success, at_least: 0.1}", ["success: there is no figure"]),
    ],
)
def test_what_falls_short(tmp_path: Path, threshold: str, texts: list[str]) -> None:
    gate = read_gate(gate_file(tmp_path, f"thresholds: [{threshold}]\n"))
    assert [found.text for found in shortfalls(gate, ROWS, ["me"])] == texts


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("thresholds:\n  - {metric: driving_scor, at_least: 3}\n", "gate.yaml:2: thresholds.0.metric: unknown metric"),
        ("thresholds:\n  - {metric: success}\n", "gate.yaml:2: thresholds.0: .*needs at_least or at_most"),
        (
            "thresholds:\n  - metric: success\n    atleast: 3\n",
            "gate.yaml:3: thresholds.0.atleast: unknown key 'atleast'",
        ),
        ("thresholds:\n  - metric: success\n    at_least: high\n", "gate.yaml:3: .*expected a number, got 'high'"),
        ("thresholds: []\n", "gate.yaml:1: thresholds: needs at least 1, has 0"),
        ("threshold: 3\n", "gate.yaml:1: threshold: unknown key 'threshold'; did you mean 'thresholds'"),
        ("thresholds:\n  - {metric: success, at_least: 1, version: 9}\n", "success has version 1, not 9"),
        ("thresholds: [\n", "gate.yaml:.*not YAML"),
    ],
)
def test_faults_say_where(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        read_gate(gate_file(tmp_path, text))


def test_a_gate_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"gate\.yaml: cannot be read: No such file"):
        read_gate(tmp_path / "gate.yaml")


def test_what_is_not_evaluated_is_refused_beforehand(tmp_path: Path) -> None:
    path = gate_file(
        tmp_path,
        "thresholds:\n  - {metric: success, at_least: 1, map: T9}\n  - {metric: success, at_least: 1, density: hgih}\n",
    )
    with pytest.raises(RecipeError) as error:
        check_names(read_gate(path), path, ["T1", "T2"], ["low"], ["me"])
    assert str(error.value) == (
        f"{path}:2: thresholds.0.map: the map 'T9' is not evaluated. Allowed: T1, T2, average\n"
        f"{path}:3: thresholds.1.density: the density 'hgih' is not evaluated. Allowed: low"
    )
