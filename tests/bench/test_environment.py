"""What the environment's bench measures and how it reports it; no figure is judged."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from parallel_worlds import Noise
from typer.testing import CliRunner

from me3bev_cli.bench.environment import ACTORS, chosen_world, crowds, growth
from me3bev_cli.bench.environment_worker import Drive, EnvironmentMeter, array_bytes, resident_megabytes
from me3bev_cli.errors import MapError, PluginError, UserError


def command(*arguments: str) -> Any:
    from me3bev_cli.main import app

    return CliRunner().invoke(app, ["bench-env", *arguments], catch_exceptions=False)


def test_every_figure_is_there(tmp_path: Path) -> None:
    target = tmp_path / "bench.json"
    result = command("--map", "T2", "--density", "low", "--seconds", "0.2", "--rounds", "2", "--json", str(target))
    assert result.exit_code == 0
    data = json.loads(target.read_text())
    for key in (
        "full_steps_per_s", "no_camera_steps_per_s", "stock_highway_env_steps_per_s", "reset_ms", "reset_p95_ms",
        "rss_mb", "libraries_rss_mb", "full_ratio", "no_camera_ratio", "two_workers_ratio",
    ):  # fmt: skip
        assert data[key] > 0
    assert [row["actors"] for row in data["scaling"]] == list(ACTORS)
    assert data["floor"]["pixel_bytes"] == 6 * 3 * 128 * 352
    assert data["floor"]["bytes_written"] == data["floor"]["pixel_bytes"] + 4 * (9 + 4 + 5)
    assert data["floor"]["table_bytes"] > data["floor"]["pixel_bytes"]
    assert data["setup"]["map"] == "T2"
    assert "highway-env" in data["versions"]
    assert set(data["spread"]) >= {"full_ratio", "no_camera_ratio", "reset_ms"}
    assert "whole / stock" in result.stdout
    assert "grows as n^" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "kind", "text"),
    [
        (("highway", "T33", "high"), UserError, "--map: unknown map 'T33'; did you mean 'T3'?"),
        (("highway", "T3", "hihg"), UserError, "--density: unknown density 'hihg'; did you mean 'high'?"),
        (("highwy", "T3", "high"), PluginError, "unknown simulator plugin 'highwy'; did you mean 'highway'?"),
    ],
)
def test_unknown_names_are_refused(arguments: tuple[str, str, str], kind: type[UserError], text: str) -> None:
    with pytest.raises(kind, match=text.replace("?", r"\?")):
        chosen_world(*arguments)


def test_a_simulator_of_fixed_population_has_no_scaling(line_plugins: None) -> None:
    assert crowds(chosen_world("line", "F1", "low")) == {}
    numbers = {n: w.simulator.config for n, w in crowds(chosen_world("highway", "T3", "high")).items()}
    assert {n: c.vehicles + c.pedestrians for n, c in numbers.items()} == {n: n for n in ACTORS}


def test_growth_is_the_exponent() -> None:
    assert growth([50, 100, 400], [3 * n**0.5 for n in (50, 100, 400)]) == pytest.approx(0.5)
    assert growth([50], [1.0]) is None


def test_a_drive_counts_steps_and_keeps_resets_apart() -> None:
    env = Noise("a")
    drive = Drive(env, lambda: np.zeros(2), "test")
    ends = []
    inner = env.step

    def step(action: Any) -> Any:
        answer = inner(action)
        ends.append(answer[2] or answer[3])
        return answer

    env.step = step  # type: ignore[method-assign]
    found = drive.run(0.01, resets=3)
    assert found.steps == len(ends)
    assert len(found.resets) == sum(ends) + 3
    assert found.step_seconds >= 0.01


def test_array_bytes_counts_each_array_once() -> None:
    class Holder:
        pass

    table = np.zeros((10, 4))
    holder = Holder()
    holder.__dict__.update(table=table, view=table[2:], again={"x": [table, (np.zeros(3, np.uint8),)]}, me=holder)
    assert array_bytes(holder) == 323
    assert not math.isnan(resident_megabytes())


def test_an_unknown_map_in_the_measuring_process_is_a_mistake() -> None:
    from dataclasses import replace

    with pytest.raises(MapError, match="T99"):
        EnvironmentMeter()(("open", "full", replace(chosen_world("highway", "T3", "high"), map="T99")))
