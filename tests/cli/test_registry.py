"""Plugins by name: what is found, what is imported, what is said when it goes wrong."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import ModuleType

import pytest
from plugin_fakes import MODULE, entry, every

from me3bev_cli import registry
from me3bev_cli.errors import PluginError

Install = Callable[..., None]
BROKEN = entry("temporal", "broken", "no_such_module_here:Thing", "third-party", "0.3")


def test_names_are_sorted_and_import_nothing(install: Install) -> None:
    install(BROKEN, *every())
    assert registry.names("temporal") == ("attention", "broken", "unit")
    assert registry.names("fusion") == ("add",)


def test_a_plugin_is_loaded_once_by_name(fakes: None) -> None:
    plugin = registry.load("temporal", "unit")
    assert plugin.__name__ == "Unit"
    assert registry.load("temporal", "unit") is plugin
    assert registry.config_class("temporal", "unit") is plugin.Config


def test_an_unknown_name_is_answered_with_the_nearest_and_all(fakes: None) -> None:
    with pytest.raises(PluginError) as caught:
        registry.load("temporal", "atention")
    assert str(caught.value) == (
        "unknown temporal plugin 'atention'; did you mean 'attention'? Allowed: attention, unit"
    )


def test_no_plugin_of_a_kind(install: Install) -> None:
    install()
    with pytest.raises(PluginError, match=r"unknown fusion plugin 'add'. Allowed: none installed"):
        registry.load("fusion", "add")


def test_a_plugin_that_does_not_import_stops_only_itself(install: Install) -> None:
    install(BROKEN, *every())
    assert registry.load("temporal", "unit").__name__ == "Unit"
    with pytest.raises(PluginError) as caught:
        registry.load("temporal", "broken")
    assert str(caught.value) == (
        "temporal plugin 'broken' of third-party 0.3 does not import: "
        "ModuleNotFoundError: No module named 'no_such_module_here'. `me3bev plugins` lists what works"
    )


def test_any_error_of_an_import_is_reported(install: Install, monkeypatch: pytest.MonkeyPatch) -> None:
    class Lazy(ModuleType):
        def __getattr__(self, name: str) -> object:
            raise RuntimeError("needs a GPU\nsecond line")

    monkeypatch.setitem(sys.modules, "lazy_plugin", Lazy("lazy_plugin"))
    install(entry("spatial", "lazy", "lazy_plugin:Thing"))
    with pytest.raises(PluginError, match=r"does not import: RuntimeError: needs a GPU\. `me3bev plugins`"):
        registry.load("spatial", "lazy")


def test_a_duplicate_names_both_distributions(install: Install) -> None:
    install(
        entry("temporal", "unit", f"{MODULE}:Unit", "first", "1.0"),
        entry("temporal", "unit", f"{MODULE}:Attention", "second", "2.1"),
        entry("temporal", "attention", f"{MODULE}:Attention"),
    )
    assert registry.load("temporal", "attention").__name__ == "Attention"
    with pytest.raises(PluginError, match=r"'unit' is registered more than once, by first 1\.0 and second 2\.1"):
        registry.load("temporal", "unit")


def test_one_distribution_met_twice_on_the_path_is_no_duplicate(install: Install) -> None:
    install(entry("temporal", "unit", f"{MODULE}:Unit"), entry("temporal", "unit", f"{MODULE}:Unit"))
    assert registry.load("temporal", "unit").__name__ == "Unit"


@pytest.mark.parametrize(
    ("attribute", "problem"),
    [
        ("NOT_A_CLASS", "is not a class"),
        ("NoContract", "has no Config derived from me3bev_cli.api.PluginConfig"),
        ("Named", "has a Config with the key 'name', which recipes use themselves"),
    ],
)
def test_what_breaks_the_contract_is_refused(install: Install, attribute: str, problem: str) -> None:
    install(entry("temporal", "odd", f"{MODULE}:{attribute}"))
    with pytest.raises(PluginError) as caught:
        registry.load("temporal", "odd")
    assert str(caught.value) == f"temporal plugin 'odd' of faked 1.0: {MODULE}:{attribute} {problem}"


def test_the_catalogue_shows_everything_and_breaks_on_nothing(install: Install) -> None:
    twice = entry("fusion", "add", f"{MODULE}:Add", "other", "9")
    install(BROKEN, twice, *every())
    rows = {(row.kind, row.name, row.distribution): row for row in registry.catalogue()}
    broken = rows["temporal", "broken", "third-party 0.3"]
    assert broken.status == "broken"
    assert broken.reason == "ModuleNotFoundError: No module named 'no_such_module_here'"
    sound = rows["temporal", "attention", "faked 1.0"]
    assert (sound.status, sound.keys) == ("ok", ("heads", "dropout"))
    for owner in ("faked 1.0", "other 9"):
        assert "registered more than once" in rows["fusion", "add", owner].reason


def test_the_built_in_plugins_are_registered() -> None:
    registry.clear()
    assert set(registry.names("temporal")) >= {"mamba", "gru", "lstm", "transformer"}
    assert "highway" in registry.names("simulator")
