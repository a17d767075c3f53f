"""What every plugin has: a kind, and a configuration."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

GROUPS = {
    "spatial": "me3bev.spatial",
    "temporal": "me3bev.temporal",
    "fusion": "me3bev.fusion",
    "simulator": "me3bev.simulator",
}
"""Kind of plugin -> entry-point group."""


class PluginConfig(BaseModel):
    """Base of every plugin's configuration: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class NoConfig(PluginConfig):
    """For a plugin without settings."""
