"""The embedded simulator: towns on highway-env's roads and kinematics, traffic in arrays, drawn cameras.

Importing this package registers the environment with gymnasium, so either of these makes one:

    gymnasium.make("me3bev_plugins.simulator.highway:me3bev/Town-v0", map="T3", density="high")

    import me3bev_plugins.simulator.highway
    gymnasium.make("me3bev/Town-v0", map="T3", density="high")
"""

from __future__ import annotations

import os

import gymnasium

# highway-env draws with pygame, which otherwise looks for a display.
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

from me3bev_plugins.simulator.highway.simulator import Highway, HighwayConfig

__all__ = ["ENV_ID", "Highway", "HighwayConfig"]

ENV_ID = "me3bev/Town-v0"
"""Name of the environment in gymnasium's registry."""

if ENV_ID not in gymnasium.registry:
    gymnasium.register(id=ENV_ID, entry_point="me3bev_plugins.simulator.highway.env:TownEnv")
