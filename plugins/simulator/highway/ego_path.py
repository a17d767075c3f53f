"""`EgoPath`: what the traffic is told of where the ego is going."""

from __future__ import annotations

from dataclasses import dataclass

from me3bev_plugins.simulator.highway.town import Ints


@dataclass(eq=False)
class EgoPath:
    """The ego on its route."""

    lanes: Ints
    """Ids of the route's lanes, in order."""
    index: int
    """Which of them the ego is on."""
    s: float
    """Arc length on it, metres."""
    lateral: float
    """Metres left of its centre."""
