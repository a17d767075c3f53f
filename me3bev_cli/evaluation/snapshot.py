"""One instant of an evaluation as it was seen, for its picture."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.files import atomic_write_bytes


@dataclass(frozen=True, eq=False)
class Snapshot:
    """One instant as it was seen."""

    method: str
    """Who drove."""
    map: str
    density: str
    weather: str
    step: int
    cameras: tuple[str, ...]
    images: NDArray[np.uint8]
    """(C, 3, H, W)."""
    bev: NDArray[np.uint8]
    """(X, Y), classes as `api.BEV_CLASSES`."""

    def save(self, path: Path) -> None:
        """Write it, whole or not at all. The same snapshot gives the same bytes."""
        header = {key: value for key, value in vars(self).items() if key not in ("images", "bev")}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, header=np.array(json.dumps(header)), images=self.images, bev=self.bev)
        atomic_write_bytes(path, buffer.getvalue())


def load_snapshot(path: Path) -> Snapshot | None:
    """What `Snapshot.save` wrote; None when it is not there or damaged: a picture can be taken again."""
    try:
        with np.load(path, allow_pickle=False) as file:
            header = json.loads(str(file["header"]))
            return Snapshot(**{**header, "cameras": tuple(header["cameras"])}, images=file["images"], bev=file["bev"])
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
        return None
