"""Plugins of no substance for tests of names, recipes and messages: nothing is installed, no torch is imported."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint
from types import ModuleType, SimpleNamespace
from typing import Any, Literal

from pydantic import Field

from me3bev_cli.api import Camera, NoConfig, ObservationConfig, PluginConfig, Rig, TokenSpec

MODULE = "faked_plugins"


def entry(kind: str, name: str, value: str, distribution: str = "faked", version: str = "1.0") -> EntryPoint:
    """An entry point as an installed distribution would give it."""
    point = EntryPoint(name=name, value=value, group=f"me3bev.{kind}")
    vars(point).update(dist=SimpleNamespace(name=distribution, version=version))
    return point


class World:
    class Config(PluginConfig):
        vehicles: int | None = Field(default=None, ge=0)
        horizon: int = Field(default=128, gt=0)

    def __init__(self, config: Any) -> None:
        self.config = config

    def maps(self) -> tuple[str, ...]:
        return "T1", "T3"

    def densities(self) -> tuple[str, ...]:
        return "low", "high"

    def weathers(self) -> tuple[str, ...]:
        return "clear", "night", "fog"

    def rig(self, observation: ObservationConfig) -> Rig:
        for name in observation.cameras:
            if name not in ("front", "back"):
                raise ValueError(f"there is no camera '{name}'")
        size = {"width": observation.width, "height": observation.height}
        optics = {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "position": (0.0, 0.0, 1.0), "yaw": 0.0}
        return Rig(cameras=tuple(Camera(name=name, **size, **optics) for name in observation.cameras))


class Desert(World):
    def weathers(self) -> tuple[str, ...]:
        return "sand", "heat"


class Grid:
    class Config(PluginConfig):
        trunk: Literal["tiny", "large"] = "tiny"
        channels: int = Field(default=8, ge=1)

    @classmethod
    def output_spec(cls, config: Any, rig: Rig) -> TokenSpec:
        if rig.image_size[0] % 16:
            raise ValueError(f"image height {rig.image_size[0]} is not a multiple of 16")
        return TokenSpec(2, 2, config.channels)


class Flat:
    class Config(PluginConfig):
        width: int = 32

    @classmethod
    def output_spec(cls, config: Any, rig: Rig) -> TokenSpec:
        return TokenSpec(1, 1, config.width)


class Attention:
    class Config(PluginConfig):
        heads: int = Field(default=4, ge=1)
        dropout: float | None = Field(default=0.1, ge=0, lt=1)

    @classmethod
    def check(cls, config: Any, width: int) -> None:
        if width % config.heads:
            raise ValueError(f"width {width} is not a multiple of heads {config.heads}")


class Unit:
    class Config(PluginConfig):
        layers: int = 1

    @classmethod
    def check(cls, config: Any, width: int) -> None:
        """Any width fits."""


class Add:
    Config = NoConfig

    @classmethod
    def output_width(cls, config: Any, widths: Mapping[str, int]) -> int:
        if len(set(widths.values())) > 1:
            raise ValueError("adding needs equal widths")
        return next(iter(widths.values()))


class NoContract:
    """A class without Config."""


class Named:
    """A class whose configuration takes the key that names the plugin."""

    class Config(PluginConfig):
        name: str = "me"


PLUGINS = {
    "simulator": {"world": World},
    "spatial": {"grid": Grid, "flat": Flat},
    "temporal": {"attention": Attention, "unit": Unit},
    "fusion": {"add": Add},
}


def module() -> ModuleType:
    """A module with every class of this file, under the name that the entry points import."""
    made = ModuleType(MODULE)
    for plugins in PLUGINS.values():
        for plugin in plugins.values():
            setattr(made, plugin.__name__, plugin)
    made.Desert = Desert  # type: ignore[attr-defined]
    made.NoContract = NoContract  # type: ignore[attr-defined]
    made.Named = Named  # type: ignore[attr-defined]
    made.NOT_A_CLASS = 3  # type: ignore[attr-defined]
    return made


def every() -> list[EntryPoint]:
    """Entry points of all plugins of this file."""
    return [
        entry(kind, name, f"{MODULE}:{plugin.__name__}")
        for kind, plugins in PLUGINS.items()
        for name, plugin in plugins.items()
    ]


RECIPE = """\
simulator: {name: world, map: T3, density: low}
observation:
  cameras: [front, back]
  height: 32
  width: 64
spatial:
  name: grid
  channels: 16
encoders: {bev: {width: 32}, vr: {width: 32}, nav: {width: 32}}
temporal: {name: attention, heads: 2}
context: {kind: window, length: 4}
fusion: {name: add}
stages:
  - kind: ppo
    steps: 1000
    learning_rate: {initial: 1e-3, drop: 0.5, every: 100}
"""
