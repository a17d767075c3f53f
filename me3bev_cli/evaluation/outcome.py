"""From episodes to everything that is written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from me3bev_cli.evaluation import folder
from me3bev_cli.evaluation.compare import compare
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.latex import latex_text
from me3bev_cli.evaluation.markdown import markdown_text
from me3bev_cli.evaluation.published import published_rows
from me3bev_cli.evaluation.results import Results, document
from me3bev_cli.evaluation.snapshot import Snapshot
from me3bev_cli.evaluation.summary import by_weather, rows_of, score
from me3bev_cli.evaluation.tables import csv_text
from me3bev_cli.files import atomic_write_bytes, atomic_write_text
from me3bev_cli.output import write_json


def work_out(
    episodes: Sequence[Episode], *, baseline: str | None = None, paper: bool = False, lost: Sequence[str] = ()
) -> Results:
    """Every figure of some episodes.

    Args:
        baseline: label of the method that the others are compared with.
        paper: whether the published figures of the same maps and densities are wanted.
        lost: logs that could not be read.

    Raises:
        UserError: the baseline has no episode, or shares none with another method.
    """
    scored = score(episodes)
    weathers = list(dict.fromkeys(episode.weather for episode in episodes))
    maps = list(dict.fromkeys(episode.map for episode in episodes))
    densities = list(dict.fromkeys(episode.density for episode in episodes))
    return Results(
        rows_of(scored),
        by_weather(episodes, sorted(weathers)) if len(weathers) > 1 else (),
        compare(scored, baseline) if baseline is not None else (),
        published_rows(maps, densities) if paper else (),
        lost,
    )


@dataclass(eq=False)
class Outcome:
    """What an evaluation found, in every form."""

    setup: dict[str, Any]
    results: Results
    snapshot: Snapshot | None = None

    @cached_property
    def document(self) -> dict[str, Any]:
        """What `results.json` holds."""
        return document(self.setup, self.results)

    @cached_property
    def csv(self) -> str:
        """The rows as CSV."""
        return csv_text(self.results.shown)

    @cached_property
    def markdown(self) -> str:
        """Tables for a README or an issue."""
        return markdown_text(self.results)

    @cached_property
    def latex(self) -> str:
        """A table for a paper."""
        return latex_text(self.results)

    @cached_property
    def picture(self) -> bytes:
        """The picture as PNG."""
        from me3bev_cli.evaluation.picture import picture_bytes

        methods = ", ".join(dict.fromkeys(row.method for row in self.results.rows))
        count, seed = self.setup.get("episodes"), self.setup.get("seed")
        title = f"{methods}: {count} episodes per map and density, seed {seed}" if count else f"{methods}: from logs"
        return picture_bytes(self.results.rows, title, self.snapshot)

    def write(self, out: Path) -> list[Path]:
        """Write the figures into an evaluation's folder; returns the files."""
        write_json(self.document, str(out / folder.JSON))
        atomic_write_text(out / folder.CSV, self.csv)
        atomic_write_text(out / folder.MARKDOWN, self.markdown)
        atomic_write_text(out / folder.LATEX, self.latex)
        atomic_write_bytes(out / folder.PICTURE, self.picture)
        return [out / name for name in (folder.JSON, folder.CSV, folder.MARKDOWN, folder.LATEX, folder.PICTURE)]
