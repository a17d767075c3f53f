"""highway-env's classes that this simulator is built on, loaded without the plotting that comes with them.

Importing highway-env also imports matplotlib and pandas, which nothing here uses: two fifths of the time and 60 MB of
every process. They are put off until highway-env itself wants one of them.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


class _Later(ModuleType):
    """Stands for a module that is imported when something is wanted of it."""

    def __getattr__(self, name: str) -> Any:
        if sys.modules.get(self.__name__) is self:
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)


@contextmanager
def put_off(*names: str) -> Iterator[None]:
    """Modules imported inside under these names, packages first, are imported when they are used, later."""
    stands_in: dict[str, ModuleType] = {name: _Later(name) for name in names if name not in sys.modules}
    for name, module in stands_in.items():
        package, _, leaf = name.rpartition(".")
        if package in stands_in:
            setattr(stands_in[package], leaf, module)
    sys.modules.update(stands_in)
    try:
        yield
    finally:
        for name in stands_in:
            del sys.modules[name]


with put_off("matplotlib", "matplotlib.pyplot", "pandas"):
    from highway_env.envs.common.abstract import AbstractEnv
    from highway_env.envs.common.action import ActionType
    from highway_env.envs.common.observation import ObservationType
    from highway_env.road.lane import AbstractLane, LineType
    from highway_env.road.road import LaneIndex, Road, RoadNetwork
    from highway_env.vehicle.behavior import IDMVehicle
    from highway_env.vehicle.kinematics import Vehicle

__all__ = [
    "AbstractEnv",
    "AbstractLane",
    "ActionType",
    "IDMVehicle",
    "LaneIndex",
    "LineType",
    "ObservationType",
    "Road",
    "RoadNetwork",
    "Vehicle",
]
