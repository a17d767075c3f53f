"""The command line as a whole: exit codes, messages, JSON, files that are whole or not there."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from plugin_fakes import RECIPE, entry, every
from typer.testing import CliRunner

from me3bev_cli import __version__
from me3bev_cli.errors import UserError
from me3bev_cli.files import atomic_write_bytes, atomic_write_text
from me3bev_cli.main import app
from me3bev_cli.output import write_json

Write = Callable[..., str]


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, list(arguments))


def test_version() -> None:
    result = run("--version")
    assert (result.exit_code, result.stdout) == (0, f"me3bev {__version__}\n")


def test_help_lists_verbs_before_helpers() -> None:
    lines = run("--help").stdout.splitlines()
    assert lines.index("Commands:") < lines.index("Helpers:")
    helpers = [line.split()[0] for line in lines[lines.index("Helpers:") + 1 :] if line.startswith("  ")]
    assert {"recipe", "plugins"} <= set(helpers)


@pytest.mark.parametrize("arguments", [["trian"], ["train", "--no-such-option"], ["recipe", "shwo"]])
def test_a_wrong_command_line_exits_with_2(arguments: list[str]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_a_mistake_is_one_message_and_exit_code_2(recipe: Write) -> None:
    result = run("recipe", "show", recipe(), "--set", "sed=1", "--set", "temporal.heads=3")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr == (
        "me3bev: mine.yaml:10: temporal: width 16 is not a multiple of heads 3 (vectors of bev)\n"
        "mine.yaml:10: temporal: width 32 is not a multiple of heads 3 (vectors of vr and nav)\n"
        "--set sed=1: sed: unknown key 'sed'; did you mean 'seed'? Allowed: name, simulator, weather, observation, "
        "modalities, spatial, encoders, temporal, context, fusion, policy, reward, stages, evaluation, keep_every, "
        "seed, device\n"
    )


def test_a_defect_keeps_its_traceback() -> None:
    code = (
        "import sys; sys.argv = ['me3bev', 'recipe', 'list']; import me3bev_cli.recipe_loading as l; l.headline = None"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; from me3bev_cli.main import main; main()"], capture_output=True, text=True
    )
    assert done.returncode == 1
    assert "Traceback" in done.stderr
    assert "TypeError: 'NoneType' object is not callable" in done.stderr


def test_ctrl_c_exits_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    from me3bev_cli import registry

    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(registry, "catalogue", interrupted)
    result = run("plugins")
    assert (result.exit_code, result.stderr) == (130, "me3bev: stopped\n")


def test_plugins_shows_the_broken_with_the_reason(install: Callable[..., None]) -> None:
    install(*every(), entry("temporal", "broken", "no_such_module_here:Thing", "third-party", "0.3"))
    result = run("plugins")
    assert result.exit_code == 0
    rows = {line.split()[1]: line.rstrip().split(maxsplit=5) for line in result.stdout.splitlines()}
    assert rows["attention"] == ["temporal", "attention", "faked", "1.0", "ok", "heads, dropout"]
    assert rows["broken"][2:] == [
        "third-party",
        "0.3",
        "broken",
        "ModuleNotFoundError: No module named 'no_such_module_here'",
    ]


def test_plugins_as_json(fakes: None, tmp_path: Path) -> None:
    result = run("plugins", "--json", "-")
    row = {"kind": "temporal", "name": "unit", "distribution": "faked 1.0", "reason": "", "keys": ["layers"]}
    assert row | {"status": "ok"} in json.loads(result.stdout)["plugins"]
    assert "temporal" in result.stderr
    run("plugins", "--json", str(tmp_path / "new" / "plugins.json"))
    assert json.loads((tmp_path / "new" / "plugins.json").read_text()) == json.loads(result.stdout)


def test_recipe_show_prints_what_it_would_run(recipe: Write) -> None:
    shown = run("recipe", "show", recipe(), "--set", "seed=9")
    assert shown.exit_code == 0
    Path("shown.yaml").write_text(shown.stdout)
    assert run("recipe", "show", "shown.yaml").stdout == shown.stdout
    assert json.loads(run("recipe", "show", "mine.yaml", "--json", "-").stdout)["temporal"]["heads"] == 2


def test_recipe_validate_says_the_sizes(recipe: Write) -> None:
    result = run("recipe", "validate", recipe(), recipe(name="other.yaml"))
    line = "fits; bev 2x2 tokens of 16 -> 32, vr 32, nav 32; fused 32"
    assert (result.exit_code, result.stdout) == (0, f"mine.yaml: {line}\nother.yaml: {line}\n")


def test_recipe_validate_goes_on_to_the_next_file(recipe: Write) -> None:
    recipe(RECIPE.replace("name: add", "name: ad"), "bad.yaml")
    result = run("recipe", "validate", "bad.yaml", recipe(), "nosuch.yaml", "--json", "out.json")
    assert result.exit_code == 2
    assert result.stdout.startswith("mine.yaml: fits")
    assert result.stderr.startswith("me3bev: bad.yaml:12: fusion.name: unknown fusion plugin 'ad'; did you mean 'add'?")
    assert "there is no file 'nosuch.yaml'" in result.stderr
    rows = json.loads(Path("out.json").read_text())["recipes"]
    assert [(row["recipe"], row["ok"], len(row["faults"])) for row in rows] == [
        ("bad.yaml", False, 1),
        ("mine.yaml", True, 0),
        ("nosuch.yaml", False, 1),
    ]


def test_recipe_list_names_every_shipped_recipe() -> None:
    from me3bev_cli.recipe_loading import shipped_recipes

    result = run("recipe", "list")
    assert [line.split()[0] for line in result.stdout.splitlines()] == list(shipped_recipes())


def test_the_schema_knows_the_plugins(install: Callable[..., None]) -> None:
    install(*every(), entry("temporal", "broken", "no_such_module_here:Thing"))
    schema = json.loads(run("recipe", "schema").stdout)
    blocks = {block["properties"]["name"]["const"]: block for block in schema["properties"]["temporal"]["anyOf"][:-1]}
    assert set(blocks) == {"attention", "broken", "unit"}
    assert set(blocks["attention"]["properties"]) == {"name", "heads", "dropout"}
    assert blocks["attention"]["additionalProperties"] is False
    assert "additionalProperties" not in blocks["broken"]
    assert schema["properties"]["temporal"]["anyOf"][-1] == {"type": "null"}
    simulator = schema["properties"]["simulator"]["anyOf"][0]["properties"]
    assert set(simulator) == {"name", "map", "density", "vehicles", "horizon"}
    assert {"extends", "stages", "context", "weather"} <= set(schema["properties"])
    some, nothing = schema["$defs"]["Weather"]["properties"]["training"]["anyOf"]
    assert (some["type"], some["minItems"], some["uniqueItems"], nothing["type"]) == ("array", 1, True, "null")
    assert "required" not in schema
    assert _references(schema) <= {f"#/$defs/{name}" for name in schema["$defs"]}


def _references(schema: Any) -> set[str]:
    if isinstance(schema, dict):
        own = {schema["$ref"]} if isinstance(schema.get("$ref"), str) else set()
        return own.union(*(_references(value) for value in schema.values()))
    return set().union(*(_references(item) for item in schema)) if isinstance(schema, list) else set()


def test_json_has_no_nan_and_takes_numbers_of_other_libraries(tmp_path: Path) -> None:
    class Scalar:
        def item(self) -> float:
            return 1.5

    target = tmp_path / "out.json"
    write_json({"a": [float("nan"), float("inf"), 2.0], "b": (Scalar(), True, None), 3: "é"}, str(target))
    assert json.loads(target.read_text()) == {"a": [None, None, 2.0], "b": [1.5, True, None], "3": "é"}


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "deep" / "file.txt"
    atomic_write_text(target, "first")
    assert target.read_text() == "first"
    assert target.stat().st_mode & 0o044 == 0o044

    def full_disk(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(UserError, match=r"file\.txt: cannot be written: No space left on device"):
        atomic_write_bytes(target, b"second")
    assert target.read_text() == "first"
    assert list(target.parent.iterdir()) == [target]


def test_a_folder_in_the_way(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot be written: Is a directory"):
        write_json({}, str(tmp_path))
    assert list(tmp_path.iterdir()) == []
