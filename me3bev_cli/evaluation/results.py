"""What `results.json` holds. Nothing in it depends on when, how fast or by how many workers it was made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from me3bev_cli.evaluation.compare import Comparison
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.folder import JSON
from me3bev_cli.evaluation.published import NOTE
from me3bev_cli.evaluation.summary import LEVEL, RESAMPLES, Row, WeatherRow

__all__ = ["JSON", "Results", "document"]


@dataclass(frozen=True)
class Results:
    """All figures of an evaluation."""

    rows: Sequence[Row]
    by_weather: Sequence[WeatherRow] = ()
    """Empty where all episodes have the same weather."""
    comparisons: Sequence[Comparison] = ()
    """Every other method beside the baseline, if there is one."""
    published: Sequence[Row] = ()
    """The paper's, if they are asked for."""
    lost: Sequence[str] = ()
    """Logs that could not be read, a sentence each."""

    @property
    def shown(self) -> list[Row]:
        """What tables have: the rows, and after them the published ones."""
        return [*self.rows, *self.published]

    @property
    def verdicts(self) -> dict[tuple[str, str, str, str], str]:
        """(method, map, density, metric) -> how it stands beside the baseline's, as `Comparison.verdict`."""
        return {(c.method, c.map, c.density, c.metric): c.verdict for c in self.comparisons}


def document(setup: dict[str, Any], results: Results) -> dict[str, Any]:
    """What `results.json` holds."""
    keys = ("version", "label", "unit", "direction", "formula", "source")
    found = {
        **setup,
        "interval": f"{LEVEL:.0%} percentile bootstrap, {RESAMPLES} resamples within each map",
        "metrics": {name: {key: getattr(metric, key) for key in keys} for name, metric in METRICS.items()},
        "rows": [asdict(row) for row in results.rows],
        "by_weather": [asdict(row) for row in results.by_weather],
    }
    if results.comparisons:
        found["baseline"] = results.comparisons[0].baseline
        found["comparisons"] = [{**asdict(c), "verdict": c.verdict} for c in results.comparisons]
    if results.published:
        found["published"] = {"note": NOTE, "rows": [asdict(row) for row in results.published]}
    if results.lost:
        found["lost"] = list(results.lost)
    return found
