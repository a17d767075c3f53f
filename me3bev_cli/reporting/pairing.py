"""Methods of several evaluations compared on the same seeds, which no single evaluation could do."""

from __future__ import annotations

from dataclasses import asdict, replace

from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.compare import compare
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.folder import EPISODES
from me3bev_cli.evaluation.logs import kept
from me3bev_cli.evaluation.summary import score
from me3bev_cli.reporting.suites import Method, Suite


def pair(suite: Suite) -> None:
    """Compare all methods of a suite that joins several evaluations, from their logs.

    The baseline is an evaluation's own, or else the first method. Where its logs are not there, nothing is changed.
    """
    if len(suite.evaluations) < 2:
        return
    episodes = [episode for method in suite.methods for episode in _episodes(suite, method)]
    try:
        found = compare(score(episodes), suite.baseline or suite.methods[0].label)
    except UserError:
        return
    suite.comparisons = [{**asdict(one), "verdict": one.verdict} for one in found]


def _episodes(suite: Suite, method: Method) -> list[Episode]:
    """What a method's logs hold of the suite, under its label in the report."""
    there = kept(method.evaluation.folder / EPISODES, method.name).episodes
    return [
        replace(episode, driver=method.label)
        for episode in there
        if episode.map in suite.maps and episode.density in suite.densities
    ]
