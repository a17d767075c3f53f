"""What `TownEnv` may be asked for, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from me3bev_cli.api import ObservationConfig
from me3bev_cli.errors import MapError, UserError, did_you_mean, unknown_name
from me3bev_plugins.simulator.highway.simulator import DENSITIES, HighwayConfig
from me3bev_plugins.simulator.highway.weather import WEATHERS, Weather, weather_named

Model = TypeVar("Model", bound=BaseModel)

ARGUMENTS = ("map", "density", "weather", "observation", "images", "render_mode", *HighwayConfig.model_fields)
"""Keyword arguments of the environment."""


def validated(model: type[Model], values: Mapping[str, Any], where: str) -> Model:
    """A config from plain values.

    Raises:
        UserError: with every fault, each named as `where.key`.
    """
    try:
        return model.model_validate(dict(values))
    except ValidationError as error:
        faults = []
        for fault in error.errors():
            key = ".".join(str(part) for part in fault["loc"])
            if fault["type"] == "extra_forbidden":
                faults.append(unknown_name("key", key, model.model_fields, where=where).render())
            else:
                faults.append(f"{where}.{key}: {fault['msg']}, got {fault['input']!r}")
        raise UserError("\n".join(faults)) from None


def observation_config(value: ObservationConfig | Mapping[str, Any] | None) -> ObservationConfig:
    """The observation asked for; None is the default one.

    Raises:
        UserError: for unknown keys and wrong values.
    """
    if isinstance(value, ObservationConfig):
        return value
    if value is None:
        return ObservationConfig()
    if not isinstance(value, Mapping):
        raise UserError(f"observation is {value!r}", allowed="an ObservationConfig, a dict of its fields, or None")
    return validated(ObservationConfig, value, "observation")


def population(density: str, config: HighwayConfig) -> tuple[int, int]:
    """(vehicles, pedestrians) of a density, with the config's overrides.

    Raises:
        MapError: for a density that does not exist.
    """
    if density not in DENSITIES:
        raise unknown_name("density", str(density), DENSITIES, kind=MapError)
    vehicles, pedestrians = DENSITIES[density]
    return (
        vehicles if config.vehicles is None else config.vehicles,
        pedestrians if config.pedestrians is None else config.pedestrians,
    )


def weather_set(value: str | Sequence[str] | None) -> tuple[Weather, ...]:
    """The kinds of weather that episodes draw from; None is the default one alone.

    Raises:
        UserError: for a weather that does not exist, or none at all.
    """
    names = WEATHERS[:1] if value is None else (value,) if isinstance(value, str) else value
    if not isinstance(names, Sequence) or not names:
        raise UserError(f"weather is {value!r}", allowed=f"one or several of {', '.join(WEATHERS)}, or None")
    return tuple(weather_named(str(name)) for name in names)


def refuse_unknown(arguments: Mapping[str, Any]) -> None:
    """Raises UserError when anything is left over."""
    for name in arguments:
        question = did_you_mean(name, ARGUMENTS)
        text = f"unknown argument '{name}' of the environment" + (f"; {question}" if question else "")
        raise UserError(text, allowed=", ".join(ARGUMENTS))
