"""Plugins by name, from the metadata of what is installed.

Listing names imports nothing. Loading imports the one plugin that is named, so a broken or duplicate plugin
stops only the recipe that asks for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from me3bev_cli.api import GROUPS, PluginConfig
from me3bev_cli.errors import PluginError, unknown_name


@dataclass(frozen=True)
class CatalogueRow:
    """One installed plugin, as `me3bev plugins` shows it."""

    kind: str
    name: str
    distribution: str
    """Distribution and version."""
    reason: str = ""
    """Why it is broken; empty when it is not."""
    keys: tuple[str, ...] = field(default=())
    """Keys that its block in a recipe takes beside `name`."""

    @property
    def status(self) -> str:
        """`ok` or `broken`."""
        return "broken" if self.reason else "ok"


def distribution(entry: EntryPoint) -> str:
    """Name and version of the distribution that registers `entry`."""
    dist = entry.dist
    return f"{dist.name} {dist.version}" if dist is not None else "an unnamed distribution"


@cache
def _entries(kind: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Entry points of a group by name; more than one under a name is a duplicate, shown when it is asked for."""
    found: dict[str, dict[tuple[str, str], EntryPoint]] = {}
    for entry in entry_points(group=GROUPS[kind]):
        # The same distribution can be met twice on the path (an editable install seen from its own folder).
        found.setdefault(entry.name, {})[(distribution(entry), entry.value)] = entry
    return {name: tuple(entries.values()) for name, entries in sorted(found.items())}


def clear() -> None:
    """Forget what was read, as after an installation; tests call it around faked entry points."""
    _entries.cache_clear()
    _load.cache_clear()


def names(kind: str) -> tuple[str, ...]:
    """Names of the installed plugins of a kind (a key of `api.GROUPS`), sorted; imports none of them."""
    return tuple(_entries(kind))


def load(kind: str, name: str) -> type[Any]:
    """The plugin class registered under `name`.

    Raises:
        PluginError: unknown, registered twice, or its module does not import.
    """
    return _load(kind, name)


@cache
def _load(kind: str, name: str) -> type[Any]:
    entries = _entries(kind).get(name, ())
    if not entries:
        raise unknown_name(f"{kind} plugin", name, names(kind), kind=PluginError)
    if len(entries) > 1:
        owners = " and ".join(sorted(distribution(entry) for entry in entries))
        raise PluginError(
            f"{kind} plugin '{name}' is registered more than once, by {owners}", hint="Uninstall all but one"
        )
    entry = entries[0]
    try:
        plugin = entry.load()
    except Exception as error:
        raise PluginError(
            f"{kind} plugin '{name}' of {distribution(entry)} does not import: {_reason(error)}",
            hint="`me3bev plugins` lists what works",
        ) from error
    problem = _contract_problem(kind, plugin)
    if problem:
        raise PluginError(f"{kind} plugin '{name}' of {distribution(entry)}: {entry.value} {problem}")
    return plugin


def _reason(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".strip().splitlines()[0]


RESERVED = {"simulator": ("name", "map", "density")}
"""Keys of a recipe's plugin block that are not the plugin's; `name` for the other kinds."""


def _contract_problem(kind: str, plugin: Any) -> str:
    if not isinstance(plugin, type):
        return "is not a class"
    config = getattr(plugin, "Config", None)
    if not (isinstance(config, type) and issubclass(config, PluginConfig)):
        return "has no Config derived from me3bev_cli.api.PluginConfig"
    taken = [key for key in RESERVED.get(kind, ("name",)) if key in config.model_fields]
    return f"has a Config with the key '{taken[0]}', which recipes use themselves" if taken else ""


def config_class(kind: str, name: str) -> type[PluginConfig]:
    """The configuration model of a plugin. Raises PluginError as `load` does."""
    model: type[PluginConfig] = load(kind, name).Config
    return model


def catalogue() -> list[CatalogueRow]:
    """Every installed plugin, broken and duplicate ones included with the reason. Imports all of them."""
    rows: list[CatalogueRow] = []
    for kind in GROUPS:
        for name, entries in _entries(kind).items():
            try:
                keys, reason = tuple(config_class(kind, name).model_fields), ""
            except PluginError as error:
                cause = error.__cause__
                keys, reason = (), _reason(cause) if isinstance(cause, Exception) else error.what
            rows.extend(CatalogueRow(kind, name, distribution(entry), reason, keys) for entry in entries)
    return rows
