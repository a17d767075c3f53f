"""An evaluation's folder.

OUT/
    results.json   what was evaluated, how each metric is defined, the rows; and by weather where there are several
    results.csv    the rows
    results.png    bars with intervals, and what the cameras saw
    episodes/      one log per episode: metrics can be computed from them again
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.summary import LEVEL, RESAMPLES, Row, WeatherRow

JSON, CSV, PICTURE, EPISODES = "results.json", "results.csv", "results.png", "episodes"


def document(setup: dict[str, Any], rows: Sequence[Row], weather_rows: Sequence[WeatherRow]) -> dict[str, Any]:
    """What `results.json` holds. Nothing in it depends on when or how fast it was made."""
    definitions = {
        name: {
            "version": metric.version,
            "unit": metric.unit,
            "direction": metric.direction,
            "formula": metric.formula,
            "source": metric.source,
        }
        for name, metric in METRICS.items()
    }
    interval = f"{LEVEL:.0%} percentile bootstrap, {RESAMPLES} resamples within each map"
    return {
        **setup,
        "interval": interval,
        "metrics": definitions,
        "rows": [asdict(row) for row in rows],
        "by_weather": [asdict(row) for row in weather_rows],
    }


def refuse_foreign(out: Path) -> None:
    """Raises UserError when `out` holds something that is no evaluation, so that nothing is mixed up."""
    if out.is_dir() and any(out.iterdir()) and not (out / JSON).is_file():
        raise UserError(f"{out} exists and holds something other than an evaluation", where="--out")
    if out.exists() and not out.is_dir():
        raise UserError(f"{out} is not a folder", where="--out")


def save_episodes(out: Path, episodes: Sequence[Episode]) -> Path:
    """Write the logs in place of those of an earlier evaluation; returns their folder."""
    final = out / EPISODES
    temporary = out / f".{EPISODES}.{os.getpid()}"
    try:
        temporary.mkdir(parents=True)
        for episode in episodes:
            episode.save(temporary / episode.file_name)
        if final.exists():
            shutil.rmtree(final)
        temporary.rename(final)
    except OSError as error:
        raise UserError(f"cannot be written: {error.strerror}", where=str(final)) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return final
