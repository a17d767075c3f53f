"""What the README shows is true: its plugin works, its recipe fits, its commands and options exist."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import typer

from me3bev_cli import registry
from me3bev_cli.main import app
from me3bev_cli.recipe_loading import resolve_recipe, shipped_recipes
from me3bev_cli.testing import check_plugin

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> type:
    """The README's plugin, installed as its one line says."""
    source = next(block for block in blocks("python") if block.startswith("# ema.py"))
    (tmp_path / "ema.py").write_text(source)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "ema", raising=False)
    group, name, value = re.findall(r'entry-points."(.*?)"\]\n(\w+) = "(.*?)"', blocks("toml")[0])[0]
    real = registry.entry_points
    extra = EntryPoint(name, value, group)
    monkeypatch.setattr(
        registry, "entry_points", lambda *, group: [*real(group=group), *([extra] if group == extra.group else [])]
    )
    registry.clear()
    return importlib.import_module("ema").MovingAverage


def test_the_plugin_keeps_its_contract_and_joins_a_recipe(example: type) -> None:
    check_plugin("temporal", example)
    recipe = resolve_recipe("small", ["temporal={name: ema, rate: 0.3}"])
    assert recipe.temporal is not None
    assert recipe.temporal.settings == {"rate": 0.3}
    registry.clear()


def test_the_recipe_fits(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(blocks("yaml")[0])
    assert resolve_recipe(tmp_path / "mine.yaml").context.kind == "stream"


def test_every_shipped_recipe_is_named() -> None:
    assert all(f"`{name}`" in README for name in shipped_recipes())


def commands() -> list[str]:
    lines = [line.split(" #")[0].strip() for block in blocks("sh") for line in block.splitlines()]
    return [line.split(" > ")[0] for line in lines if line.startswith("me3bev ")]


@pytest.mark.parametrize("line", commands())
def test_commands_and_options_exist(line: str) -> None:
    command = typer.main.get_command(app)
    words = shlex.split(line)[1:]
    while words and hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    assert {word for word in words if word.startswith("--")} <= known


def test_pictures_are_there() -> None:
    for name in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / name).is_file(), name
