"""What a run writes down while it goes on: a row per update, a row per alarm, and TensorBoard's file."""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import TensorBoardOutputFormat

from me3bev_cli.files import atomic_write_text
from me3bev_cli.training.alarms import disk_error
from me3bev_cli.training.checkpoint import checkpoints
from me3bev_cli.training.curve import read_metrics

METRICS, ALARMS, BOARD = "metrics.jsonl", "alarms.jsonl", "tensorboard"


class Journal:
    """Writes the log of a run folder. Every method raises DiskError when it cannot be written."""

    def __init__(self, run: Path) -> None:
        self.run = run
        self._board: TensorBoardOutputFormat | None = None
        self._alarms: Counter[str] = Counter()

    def row(self, standing: Mapping[str, Any], values: Mapping[str, float | None]) -> dict[str, Any]:
        """Write a row: where the run stands, what is to be told, and the alarms since the row before; returns it."""
        row = {**standing, **{key: value if _finite(value) else None for key, value in values.items()}}
        row |= {f"{kind}_alarms": count for kind, count in self._alarms.items()}
        self._alarms.clear()
        scalars = {f"{row['kind']}/{key}": value for key, value in values.items() if value is not None}
        with self._writing(self.run / METRICS) as path:
            _append(path, row)
            if self._board is None:
                self._board = TensorBoardOutputFormat(str(self.run / BOARD))
            self._board.write(scalars, dict.fromkeys(scalars, ()), row["steps"])
        return row

    def alarm(self, kind: str, text: str, steps: int) -> None:
        """Write down an alarm after which the run goes on."""
        self._alarms[kind] += 1
        with self._writing(self.run / ALARMS) as path:
            now = time.strftime("%Y-%m-%dT%H:%M:%S%z")
            _append(path, {"time": now, "steps": steps, "alarm": kind, "text": text})

    def forget_after(self, steps: int) -> None:
        """Drop the rows beyond a checkpoint: those updates were lost and are made again."""
        rows = [row for row in read_metrics(self.run) if row["steps"] <= steps]
        atomic_write_text(self.run / METRICS, "".join(json.dumps(row) + "\n" for row in rows))

    @contextmanager
    def _writing(self, path: Path) -> Iterator[Path]:
        try:
            yield path
        except OSError as error:
            found = checkpoints(self.run)
            raise disk_error(path, error, self.run, found[-1] if found else None) from error


def _append(path: Path, row: dict[str, Any]) -> None:
    with open(path, "a") as file:
        file.write(json.dumps(row) + "\n")


def _finite(value: float | None) -> bool:
    return value is None or math.isfinite(value)
