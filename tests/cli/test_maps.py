"""`me3bev maps`: what it prints and writes, what it refuses, and how little it imports."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import plugin_fakes
import pytest
from simulator.opendrive_text import stadium
from typer.testing import CliRunner

from me3bev_cli.api import FactRow, MapEntry
from me3bev_cli.errors import MapError
from me3bev_cli.main import app


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["maps", *arguments])


class Atlas(plugin_fakes.World):
    """A simulator with a library of maps that holds nothing but what the tests look for."""

    def map_entries(self) -> tuple[MapEntry, ...]:
        return MapEntry("T1", "built-in", "round"), MapEntry("T3", "imported", "[square]")

    def import_map(self, source: Path, name: str | None, replace: bool) -> MapEntry:
        return MapEntry(name or source.stem, "imported", f"replace {replace}")

    def remove_map(self, name: str) -> None:
        if name == "T1":
            raise MapError("'T1' is built in")

    def map_digest(self, name: str) -> str | None:
        return None

    def map_facts(self, name: str) -> tuple[FactRow, ...]:
        return (
            FactRow("lanes", 14.331, "km", 14.0, "15 %", True),
            FactRow("merges", 3.0, "", 1.0, "1 or 15 %", False),
            FactRow("bend", float("inf"), "m"),
        )

    def map_plan(self, name: str, seed: int) -> Any:
        return np.full((4, 6, 3), (10 * seed, 20, 30), np.uint8)


@pytest.fixture
def atlas(install: Callable[..., None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys.modules[plugin_fakes.MODULE], "Atlas", Atlas, raising=False)
    install(*plugin_fakes.every(), plugin_fakes.entry("simulator", "highway", f"{plugin_fakes.MODULE}:Atlas"))
    monkeypatch.chdir(tmp_path)


def test_list_shows_name_source_and_what_a_map_is(atlas: None) -> None:
    result = run("list")
    assert result.exit_code == 0
    assert [line.split() for line in result.stdout.splitlines()] == [
        ["map", "source", "about"],
        ["T1", "built-in", "round"],
        ["T3", "imported", "[square]"],
    ]
    rows = json.loads(run("list", "--json", "-").stdout)["maps"]
    assert rows[1] == {"name": "T3", "source": "imported", "description": "[square]"}


def test_show_writes_a_png_in_true_colours(atlas: None) -> None:
    assert run("show", "T3", "--seed", "2").stdout == "wrote T3.png\n"
    assert cv2.imread("T3.png")[0, 0].tolist() == [30, 20, 20]
    assert run("show", "T3", "--out", "new/plan.png").exit_code == 0
    assert [path.name for path in Path("new").iterdir()] == ["plan.png"]
    wrong = run("show", "T3", "--out", "plan.txt")
    assert (wrong.exit_code, wrong.stderr) == (
        2,
        "me3bev: --out: 'plan.txt' does not end in .png. Allowed: a .png file\n",
    )


def test_facts_stand_beside_what_they_should_be(atlas: None) -> None:
    result = run("facts", "T1,T3", "--json", "facts.json")
    assert result.exit_code == 0
    lines = [line.split() for line in result.stdout.splitlines()]
    assert lines[:5] == [
        ["T1"],
        ["fact", "measured", "reference", "unit", "tolerance", "within"],
        ["lanes", "14.33", "14", "km", "15", "%", "yes"],
        ["merges", "3", "1", "1", "or", "15", "%", "no"],
        ["bend", "inf", "m"],
    ]
    data = json.loads(Path("facts.json").read_text())["maps"]
    assert list(data) == ["T1", "T3"]
    assert data["T3"][1] == {
        "key": "merges", "value": 3.0, "unit": "", "reference": 1.0, "tolerance": "1 or 15 %", "within": False,
    }  # fmt: skip
    assert run("facts", "T2").stderr.startswith("me3bev: MAPS: unknown map 'T2'")


def test_import_and_remove_say_what_they_did(atlas: None) -> None:
    assert run("import", "a/Town03.xodr", "--replace").stdout == "imported Town03: replace True\n"
    assert run("import", "Town03.xodr", "--name", "mine").stdout == "imported mine: replace False\n"
    assert run("remove", "mine").stdout == "removed mine\n"
    refused = run("remove", "T1")
    assert (refused.exit_code, refused.stderr) == (2, "me3bev: 'T1' is built in\n")


@pytest.mark.parametrize("command", [["list"], ["show", "T3"], ["facts", "T3"], ["import", "x"], ["remove", "x"]])
def test_a_simulator_without_a_library_is_refused(fakes: None, command: list[str]) -> None:
    result = run(*command, "--simulator", "world")
    assert result.exit_code == 2
    assert result.stderr == "me3bev: --simulator: simulator 'world' keeps no library of maps\n"


def test_an_unknown_simulator_is_refused(fakes: None) -> None:
    result = run("list", "--simulator", "wrld")
    assert result.exit_code == 2
    assert "unknown simulator plugin 'wrld'; did you mean 'world'?" in result.stderr


HEAVY = "[m for m in ('torch', 'numba', 'cv2', 'highway_env', 'matplotlib') if m in sys.modules]"


@pytest.mark.parametrize(
    "arguments", [["list"], ["--help"], ["import", "nowhere.xodr", "--name", "T1"], ["remove", "nothing"]]
)
def test_names_and_mistakes_need_no_town_and_no_torch(arguments: list[str]) -> None:
    code = f"import sys; sys.argv = ['me3bev', 'maps', *{arguments}]\nfrom me3bev_cli.main import main\n"
    code += f"try: main()\nexcept SystemExit: pass\nprint({HEAVY}, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1] == "[]"


def test_a_map_of_ones_own_is_named_wherever_t3_can_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from me3bev_cli.evaluation.maps import parse_maps, shorten
    from me3bev_cli.recipe_check import check_recipe
    from me3bev_cli.recipe_loading import resolve_recipe

    monkeypatch.setenv("ME3BEV_DATA", str(tmp_path / "data"))
    monkeypatch.chdir(tmp_path)
    for name in ("Town01.xodr", "Town02.xodr"):
        Path(name).write_bytes(stadium())
        assert run("import", name).exit_code == 0
    taken = run("import", "Town01.xodr")
    assert taken.exit_code == 2
    assert "there is an imported map 'Town01' already" in taken.stderr

    simulator = check_recipe(resolve_recipe("small", ["simulator.map=Town02"])).simulator
    assert simulator.maps()[-2:] == ("Town01", "Town02")
    assert parse_maps("Town01-Town02", simulator.maps()) == ["Town01", "Town02"]
    assert shorten(["Town01", "Town02", "Town03"]) == "Town01-Town03"

    driven = CliRunner().invoke(
        app,
        [
            "eval", "--driver", "autopilot", "--maps", "Town01-Town02", "--density", "low",
            "--episodes", "1", "--workers", "2", "--out", "out", "--json", "-",
        ],
    )  # fmt: skip
    assert driven.exit_code == 0, driven.stderr
    assert {row["map"] for row in json.loads(driven.stdout)["rows"]} >= {"Town01", "Town02"}

    assert run("show", "Town01").exit_code == 0
    facts = json.loads(run("facts", "Town01", "--json", "-").stdout)["maps"]["Town01"]
    assert {row["reference"] for row in facts} == {None}
    assert run("remove", "Town01").exit_code == 0
    assert run("remove", "Town01").exit_code == 2
