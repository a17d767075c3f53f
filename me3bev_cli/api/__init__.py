"""All that a plugin author needs: the specs that stages exchange and one contract per stage.

A plugin is a class registered through an entry point of one of four groups:

    me3bev.spatial     images -> a small grid of tokens        (a torch.nn.Module)
    me3bev.temporal    a sequence of vectors -> the same, with memory (a torch.nn.Module)
    me3bev.fusion      one vector per modality -> one vector   (a torch.nn.Module)
    me3bev.simulator   maps, cameras and a gymnasium environment

Every plugin class has a `Config`, a pydantic model derived from `PluginConfig`; a recipe's keys beside
`name` are its fields. Sizes are agreed on by class methods, before anything is allocated.

Shape letters: B batch, T time, N frames, C cameras, H x W image, K tokens, D width, X x Y grid cells.
Frames: *world* x east, y north, z up; *ego* x forward, y left, z up, origin on the ground under the
vehicle's centre; *camera* x right, y down, z along the optical axis. Metres, seconds, radians; headings
counter-clockwise from x. This package imports pydantic only; torch and gymnasium appear in types.
"""

from __future__ import annotations

from me3bev_cli.api.base import GROUPS, NoConfig, PluginConfig
from me3bev_cli.api.camera import CAMERA_NAMES, Camera, Matrix, ObservationConfig, Rig
from me3bev_cli.api.loading import need_weights, weights_follow
from me3bev_cli.api.network import (
    Calibration,
    FusionPlugin,
    GridSpec,
    SpatialOutput,
    SpatialPlugin,
    State,
    TemporalPlugin,
    TokenSpec,
)
from me3bev_cli.api.simulator import (
    ACTOR_KINDS,
    BEV_CLASSES,
    LIGHT_STATES,
    NAVIGATION_WIDTH,
    ROAD_WIDTH,
    VEHICLE_WIDTH,
    Actors,
    FactRow,
    MapEntry,
    MapLibrary,
    SimulatorPlugin,
    StepRecord,
    View,
)

__all__ = [
    "ACTOR_KINDS",
    "BEV_CLASSES",
    "CAMERA_NAMES",
    "GROUPS",
    "LIGHT_STATES",
    "NAVIGATION_WIDTH",
    "ROAD_WIDTH",
    "VEHICLE_WIDTH",
    "Actors",
    "Calibration",
    "Camera",
    "FactRow",
    "FusionPlugin",
    "GridSpec",
    "MapEntry",
    "MapLibrary",
    "Matrix",
    "NoConfig",
    "ObservationConfig",
    "PluginConfig",
    "Rig",
    "SimulatorPlugin",
    "SpatialOutput",
    "SpatialPlugin",
    "State",
    "StepRecord",
    "TemporalPlugin",
    "TokenSpec",
    "View",
    "need_weights",
    "weights_follow",
]
