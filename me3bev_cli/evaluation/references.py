"""Episodes of reference drivers, kept for the next evaluation: they depend on the world, not on any run."""

from __future__ import annotations

from typing import Any

from me3bev_cli.errors import LogError, UserError
from me3bev_cli.evaluation.episode import Episode, load
from me3bev_cli.evaluation.identity import short
from me3bev_cli.evaluation.player import Method
from me3bev_cli.training.run import runs_root

FOLDER = "references"


class ReferenceLogs:
    """What a reference driver has driven in one world, with any number of maps and densities.

    Args:
        method: of a driver without a run.
        identity: the method's; another one has another folder.
    """

    def __init__(self, method: Method, identity: dict[str, Any]) -> None:
        self.folder = runs_root() / "eval" / FOLDER / f"{method.label}-{short(identity)}"

    def find(self, map: str, density: str, index: int, seed: int) -> Episode | None:
        """The episode, if it has been driven; a damaged log is none."""
        try:
            episode = load(self.folder / f"{map}-{density}-{index:05d}.npz")
        except LogError:
            return None
        return episode if (episode.map, episode.density, episode.seed) == (map, density, seed) else None

    def keep(self, episode: Episode) -> None:
        """Keep an episode. A full disk is no reason to stop an evaluation."""
        try:
            path = self.folder / episode.file_name
            if not path.exists():
                episode.save(path)
        except UserError:
            return


def reference_logs(method: Method, identity: dict[str, Any]) -> ReferenceLogs | None:
    """Where a method's episodes are shared; None for a run's policy."""
    return None if method.spec.run is not None else ReferenceLogs(method, identity)
