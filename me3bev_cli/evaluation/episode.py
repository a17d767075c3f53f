"""`Episode`: the log of one drive, typed and compact; everything that is scored is computed from it."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import StepRecord
from me3bev_cli.errors import LogError, PluginError
from me3bev_cli.files import atomic_write_bytes

FORMAT = 3
"""Version of the file format, kept in the header."""

COLLISIONS = ("", "vehicle", "pedestrian", "static")
"""What `StepRecord.collision` may say."""

CONTACTS = ("", "front", "side", "rear")
"""What `StepRecord.contact` may say."""

Ending = Literal["finished", "collision", "timeout", "stopped"]
"""Why an episode ended: at the end of its route, at a collision, cut off at the horizon, or by the simulator for
another reason."""

_TYPES = {float: "<f8", bool: "?", str: "<U10"}
STEP_DTYPE = np.dtype([(name, _TYPES[kind]) for name, kind in get_type_hints(StepRecord).items()])
"""One step as it is kept: a field for each of `StepRecord`."""

_LATER = {2: {"background_speed", "red_met"}}
"""Fields that older formats, which are still read, do not have."""
DTYPES = {
    **{
        number: np.dtype([(name, STEP_DTYPE[name]) for name in STEP_DTYPE.names or () if name not in later])
        for number, later in _LATER.items()
    },
    FORMAT: STEP_DTYPE,
}
"""Format -> its steps."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One drive.

    Args:
        map, density, weather: where.
        seed: what the environment was reset with.
        index: of the episode within its cell of map and density.
        driver: who drove.
        ended: why it ended.
        steps: (T,) of `STEP_DTYPE`, at least one; of fewer fields where the log is older.
    """

    map: str
    density: str
    weather: str
    seed: int
    index: int
    driver: str
    ended: Ending
    steps: NDArray[Any] = field(repr=False)

    def __len__(self) -> int:
        return len(self.steps)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column (T,), named as in `StepRecord`."""
        column: NDArray[Any] = self.steps[name]
        return column

    def has(self, name: str) -> bool:
        """Whether there is a column: an older log lacks what was recorded later."""
        return name in (self.steps.dtype.names or ())

    @property
    def finished(self) -> bool:
        """Whether the route was driven to its end."""
        return self.ended == "finished"

    @property
    def step_seconds(self) -> float:
        """Time between two steps, s."""
        return float(self["time"][-1]) / len(self)

    @property
    def file_name(self) -> str:
        """A name that no other episode of the same evaluation has."""
        return f"{self.map}-{self.density}-{self.index:05d}.npz"

    def save(self, path: Path) -> None:
        """Write the log, whole or not at all. The same episode gives the same bytes."""
        form = next(number for number, fields in DTYPES.items() if fields == self.steps.dtype)
        header = {key: value for key, value in vars(self).items() if key != "steps"} | {"format": form}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, header=np.array(json.dumps(header)), steps=self.steps)
        atomic_write_bytes(path, buffer.getvalue())


def ending(records: Sequence[StepRecord], *, terminated: bool) -> Ending:
    """Why an episode ended, from its records and gymnasium's flag."""
    last = records[-1]
    if last["collision"]:
        return "collision"
    if not terminated:
        return "timeout"
    return "finished" if last["route_done"] >= last["route_length"] else "stopped"


def from_records(
    records: Sequence[StepRecord],
    *,
    map: str,
    density: str,
    weather: str,
    seed: int,
    index: int,
    driver: str,
    ended: Ending,
) -> Episode:
    """The episode of what an environment reported.

    Raises:
        PluginError: the simulator's records lack a field or hold something else in it.
    """
    try:
        steps = np.array([tuple(record[name] for name in STEP_DTYPE.names or ()) for record in records], STEP_DTYPE)  # type: ignore[literal-required]
    except KeyError as error:
        raise PluginError(f"the simulator's info['record'] lacks {error}", hint="StepRecord lists the fields") from None
    except (TypeError, ValueError) as error:
        raise PluginError(f"the simulator's info['record'] is not a StepRecord: {error}") from None
    strange = set(steps["contact"].tolist()) - set(CONTACTS)
    if strange:
        names = ", ".join(repr(name) for name in CONTACTS)
        raise PluginError(f"the simulator reports the contact '{min(strange)}'", allowed=names)
    odd = set(steps["collision"].tolist()) - set(COLLISIONS)
    if odd:
        names = ", ".join(repr(name) for name in COLLISIONS)
        raise PluginError(f"the simulator reports the collision '{min(odd)}'", allowed=names)
    return Episode(map, density, weather, seed, index, driver, ended, steps)


def load(path: Path) -> Episode:
    """The episode in a file that `Episode.save` wrote.

    Raises:
        LogError: it is missing, truncated, damaged or of a newer format.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            header, steps = json.loads(str(file["header"])), file["steps"]
    except FileNotFoundError:
        raise LogError("there is no such log", where=str(path)) from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise LogError(f"the log is damaged or truncated ({error})", where=str(path)) from error
    form = header.pop("format", None) if isinstance(header, dict) else None
    if form not in DTYPES:
        known = ", ".join(map(str, DTYPES))
        raise LogError("the log has a format that this version does not read", where=str(path), allowed=known)
    if steps.dtype != DTYPES[form] or steps.ndim != 1 or not len(steps) or header.get("ended") not in get_args(Ending):
        raise LogError("the log does not hold an episode's steps", where=str(path))
    try:
        return Episode(**header, steps=steps)
    except TypeError as error:
        raise LogError(f"the log's header is not an episode's ({error})", where=str(path)) from None
