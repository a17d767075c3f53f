"""`me3bev metrics`: what each figure of `me3bev eval` means."""

from __future__ import annotations

from typing import Annotated

import typer


def metrics(
    json: Annotated[str | None, typer.Option(help="Write the list.", metavar="FILE|-")] = None,
) -> None:
    """List the metrics with formula, unit, direction, source and version."""
    from me3bev_cli.evaluation.definitions import METRICS
    from me3bev_cli.output import STDOUT, write_json

    if json != STDOUT:
        _print()
    if json is not None:
        keys = ("name", "version", "label", "unit", "direction", "formula", "source")
        write_json({"metrics": [{key: getattr(metric, key) for key in keys} for metric in METRICS.values()]}, json)


def _print() -> None:
    """A block per metric: formulas are too long for a column."""
    from me3bev_cli.evaluation.definitions import METRICS

    words = {"higher": "higher is better", "lower": "lower is better", "neither": "neither is better"}
    for metric in METRICS.values():
        typer.secho(metric.full_name, bold=True, nl=False)
        typer.echo(f"  {metric.label}; {metric.unit}; {words[metric.direction]}")
        typer.echo(f"    {metric.formula}.")
        typer.echo(f"    Source: {metric.source}.")
