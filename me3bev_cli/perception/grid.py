"""Whether a spatial plugin can learn segmentation. Needs neither torch nor numpy: recipes are checked with it."""

from __future__ import annotations

from typing import Any

from me3bev_cli.api import GridSpec, Rig
from me3bev_cli.errors import UserError

REACH = 50.0
"""Metres that the semantic truth reaches ahead, behind and to each side."""


def grid_of(plugin: Any, name: str, config: Any, rig: Rig) -> GridSpec:
    """The bird's-eye grid of a spatial plugin.

    Raises:
        UserError: it has none, or one of another extent than the truth.
    """
    told = getattr(plugin, "grid_spec", None)
    if told is None:
        raise UserError(
            f"the spatial plugin '{name}' gives no bird's-eye grid, so that it cannot learn segmentation",
            hint="Leave the perception stage out, or choose a plugin with a grid, as lift_splat",
        )
    spec: GridSpec = told(config, rig)
    for axis, extent in (("x_range", spec.x_range), ("y_range", spec.y_range)):
        if tuple(extent) != (-REACH, REACH):
            raise UserError(
                f"{axis} of the grid is {list(extent)}, the truth that a perception stage learns from reaches "
                f"from {-REACH:g} to {REACH:g} m"
            )
    return spec
