"""`check_plugin`: whether a class keeps the promises of its kind of plugin (see `me3bev_cli.api`).

A plugin's author runs it in a test; the built-in plugins pass the same checks:

    from me3bev_cli.testing import check_plugin

    def test_my_memory():
        check_plugin("temporal", MyMemory, {"layers": 2})

Nothing heavy is imported before a check runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from me3bev_cli.api import GROUPS, Camera, ObservationConfig, PluginConfig, Rig
from me3bev_cli.errors import PluginError, unknown_name

_METHODS = {
    "spatial": ("output_spec", "forward"),
    "temporal": ("check", "initial_state", "forward"),
    "fusion": ("output_width", "forward"),
    "simulator": ("maps", "densities", "weathers", "rig", "make_env"),
}


def check_plugin(
    kind: str,
    cls: type,
    config: Mapping[str, Any] | PluginConfig | None = None,
    *,
    rig: Rig | None = None,
    width: int = 32,
    widths: Mapping[str, int] | None = None,
    observation: ObservationConfig | None = None,
    seed: int = 0,
) -> None:
    """Check a plugin class against its contract.

    Args:
        kind: spatial, temporal, fusion or simulator.
        cls: the class that the entry point names.
        config: keys of its `Config`, or one ready made; None for the defaults.
        rig: cameras for a spatial plugin; by default six small ones that look all around.
        width: numbers per vector for a temporal plugin.
        widths: widths of the modalities for a fusion plugin; by default three of `width`.
        observation: what a simulator is asked for; by default small images.
        seed: of the inputs and of the parameters.

    Raises:
        PluginError: at the first promise that does not hold; the text says which and how it was seen.
        UserError: for an unknown kind.
    """
    if kind not in GROUPS:
        raise unknown_name("kind of plugin", kind, GROUPS)
    for method in _METHODS[kind]:
        if not callable(getattr(cls, method, None)):
            raise broken(cls, f"there is a method `{method}`", "it is missing")
    ready = check_config(cls, config)
    if kind == "simulator":
        from me3bev_cli.testing_simulator import check_simulator

        check_simulator(cls, ready, observation or ObservationConfig(height=32, width=64), seed)
        return
    from me3bev_cli import testing_models as models

    if kind == "spatial":
        from me3bev_cli.testing_spatial import check_spatial

        check_spatial(cls, ready, rig or small_rig(), seed)
    elif kind == "temporal":
        models.check_temporal(cls, ready, width, seed)
    else:
        models.check_fusion(cls, ready, widths or {"bev": width, "vr": width, "nav": width}, seed)


def broken(cls: type, promise: str, seen: str) -> PluginError:
    """The error for a promise that does not hold."""
    return PluginError(f"{cls.__name__} breaks its contract. Promise: {promise}. Seen: {seen}")


def require(cls: type, holds: bool, promise: str, seen: object) -> None:
    """Raise `broken` unless the promise holds."""
    if not holds:
        raise broken(cls, promise, str(seen))


def check_config(cls: type, config: Mapping[str, Any] | PluginConfig | None) -> PluginConfig:
    """The class's `Config`, filled in; it must refuse unknown keys and stay as it is."""
    from pydantic import ValidationError

    schema = getattr(cls, "Config", None)
    if not (isinstance(schema, type) and issubclass(schema, PluginConfig)):
        raise broken(cls, "`Config` is a subclass of me3bev_cli.api.PluginConfig", repr(schema))
    if isinstance(config, PluginConfig):
        require(cls, isinstance(config, schema), "the given config is one of the class's own", type(config).__name__)
        config = config.model_dump()
    given = dict(config or {})
    try:
        ready = schema(**given)
    except ValidationError as error:
        raise broken(cls, "`Config` accepts the given keys", str(error)) from error
    try:
        schema(**(given | {"no_such_key": 1}))
    except ValidationError:
        pass
    else:
        raise broken(cls, "`Config` refuses unknown keys", "it took `no_such_key`")
    require(cls, bool(schema.model_config.get("frozen")), "`Config` is frozen", "its fields can be set")
    schema.model_json_schema()
    return ready


def small_rig(height: int = 64, width: int = 96, cameras: int = 6) -> Rig:
    """Cameras of one size that look all around, 1.6 m above the ground."""
    import math

    focal = 0.7 * width
    return Rig(
        cameras=tuple(
            Camera(
                name=f"camera_{index}",
                width=width,
                height=height,
                fx=focal,
                fy=focal,
                cx=width / 2,
                cy=0.4 * height,
                position=(0.5 * math.cos(yaw), 0.5 * math.sin(yaw), 1.6),
                yaw=yaw,
            )
            for index, yaw in enumerate(2 * math.pi * index / cameras for index in range(cameras))
        )
    )
