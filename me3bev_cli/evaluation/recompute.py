"""`me3bev eval --from-logs`: every figure from logs, without a simulator."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from me3bev_cli import __version__
from me3bev_cli.errors import LogError, UserError
from me3bev_cli.evaluation import folder
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.folder import Manifest, read_manifest
from me3bev_cli.evaluation.logs import read_folders
from me3bev_cli.evaluation.snapshot import Snapshot, load_snapshot
from me3bev_cli.training.run import versions

FIGURES = ("interval", "metrics", "rows", "by_weather", "baseline", "comparisons", "published", "lost")
"""Of `results.json`; its other keys say what was evaluated."""


@dataclass(frozen=True)
class Recovered:
    """What logs give."""

    setup: dict[str, Any]
    episodes: Sequence[Episode]
    lost: Sequence[str]
    snapshot: Snapshot | None
    out: Path | None
    """Where the results belong: the evaluation that the logs are of; None for logs from elsewhere."""


def recover(folders: Sequence[Path], out: Path | None, overwrite: bool) -> Recovered:
    """The episodes of some folders of logs; of one evaluation's own folder, in its own order.

    Raises:
        LogError: there is no log, or none that is whole.
        UserError: `out` holds something.
    """
    if out is not None and out.exists() and not (out.is_dir() and not any(out.iterdir())) and not overwrite:
        raise UserError(f"{out} exists and is not empty", where="--out", hint=folder.ADVICE)
    if len(folders) == 1 and (folders[0] / folder.MANIFEST).is_file():
        return _evaluation(folders[0], out)
    found = read_folders(folders)
    episodes = _ordered(found.episodes, *(_names(found.episodes, key) for key in ("driver", "density", "map")))
    setup = {
        "me3bev": __version__,
        "versions": versions(),
        "from_logs": [str(path) for path in folders],
        "driver": None,
        "maps": _names(episodes, "map"),
        "densities": _names(episodes, "density"),
        "weather": sorted(_names(episodes, "weather")),
        "methods": [{"method": name} for name in _names(episodes, "driver")],
    }
    return Recovered(setup, episodes, found.lost, None, out)


def _evaluation(place: Path, out: Path | None) -> Recovered:
    manifest = read_manifest(place)
    found = read_folders([place / folder.EPISODES])
    labels = list(manifest.methods)
    wanted = [
        e
        for e in found.episodes
        if (e.driver in labels and e.map in manifest.maps and e.density in manifest.densities)
        and e.index < manifest.episodes
    ]
    if not wanted:
        raise LogError("holds no episode of the evaluation", where=str(place))
    lost = list(found.lost)
    missing = len(labels) * len(manifest.maps) * len(manifest.densities) * manifest.episodes - len(wanted) - len(lost)
    if missing > 0:
        lost.append(f"{missing} episode{'s are' if missing > 1 else ' is'} missing in {place}")
    episodes = _ordered(wanted, labels, manifest.densities, manifest.maps)
    return Recovered(_setup(place, manifest), episodes, lost, load_snapshot(place / folder.SNAPSHOT), out or place)


def _setup(place: Path, manifest: Manifest) -> dict[str, Any]:
    """What the evaluation said of itself; before it was finished, what its manifest says."""
    try:
        data = json.loads((place / folder.JSON).read_text(encoding="utf-8"))
        return {key: value for key, value in data.items() if key not in FIGURES}
    except (OSError, ValueError, AttributeError):
        return {
            "me3bev": __version__,
            "driver": None,
            "maps": list(manifest.maps),
            "densities": list(manifest.densities),
            "episodes": manifest.episodes,
            "methods": [{"method": label, "identity": found} for label, found in manifest.methods.items()],
        }


def _names(episodes: Sequence[Episode], key: str) -> list[str]:
    return list(dict.fromkeys(getattr(episode, key) for episode in episodes))


def _ordered(
    episodes: Sequence[Episode], drivers: Sequence[str], densities: Sequence[str], maps: Sequence[str]
) -> list[Episode]:
    def key(episode: Episode) -> tuple[int, int, int, int]:
        places = drivers.index(episode.driver), densities.index(episode.density), maps.index(episode.map)
        return (*places, episode.index)

    return sorted(episodes, key=key)
