"""From raw observations to what the encoders take: normalised images and scaled feature vectors."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from me3bev_cli.api import NAVIGATION_WIDTH, ROAD_WIDTH, VEHICLE_WIDTH, ObservationConfig

IMAGE_MEAN = (0.485, 0.456, 0.406)
IMAGE_STD = (0.229, 0.224, 0.225)
TOP_SPEED = 25.0
"""m/s that become 1 at the encoders' input."""

SOURCES = {"bev": ("images",), "vr": ("vehicle", "road"), "nav": ("navigation",)}
"""Modality -> the parts of an observation that it is made from."""

VECTOR_WIDTHS = {"vr": VEHICLE_WIDTH + ROAD_WIDTH, "nav": NAVIGATION_WIDTH}


class Sensor(nn.Module):
    """Casts and scales one batch of observations on the device they are on.

    Images arrive as uint8 and leave as ImageNet-normalised floats. R and V are joined (eq. 3). Speeds are
    divided by 25 m/s and distances by the length of the waypoint horizon, so that every input is of order one.
    """

    mean: Tensor
    deviation: Tensor
    vr_scale: Tensor
    nav_scale: Tensor

    def __init__(self, observation: ObservationConfig) -> None:
        super().__init__()
        self.register_buffer("mean", 255.0 * torch.tensor(IMAGE_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("deviation", 255.0 * torch.tensor(IMAGE_STD).view(3, 1, 1), persistent=False)
        vr = torch.ones(VEHICLE_WIDTH + ROAD_WIDTH)
        vr[1] = 1 / TOP_SPEED
        vr[VEHICLE_WIDTH + 3] = 1 / TOP_SPEED
        self.register_buffer("vr_scale", vr, persistent=False)
        horizon = observation.waypoint_spacing * NAVIGATION_WIDTH
        self.register_buffer("nav_scale", torch.full((NAVIGATION_WIDTH,), 1 / horizon), persistent=False)

    def images(self, observation: Mapping[str, Tensor]) -> Tensor:
        """(N, C, 3, H, W) uint8 -> float, normalised."""
        # The difference is a new tensor, so it may be divided where it is.
        return torch.sub(observation["images"], self.mean).div_(self.deviation)

    def vectors(self, observation: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """`vr` (N, 13): vehicle then road features; `nav` (N, 5). Those whose features are there."""
        scales = {"vr": self.vr_scale, "nav": self.nav_scale}
        return {
            name: torch.cat([observation[key] for key in SOURCES[name]], dim=-1) * scale
            for name, scale in scales.items()
            if all(key in observation for key in SOURCES[name])
        }
