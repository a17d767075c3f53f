"""`me3bev eval`: drive episodes and score them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.evaluation.session import Evaluation, Outcome


def evaluate(
    maps: Annotated[str | None, typer.Option(help="As T1-T7 or T1,T3. Default: every map.")] = None,
    density: Annotated[str | None, typer.Option(help="As low,high. Default: the recipe's.")] = None,
    weather: Annotated[
        str | None,
        typer.Option(help="As clear_noon,night or all, training, evaluation. Default: the recipe's evaluation set."),
    ] = None,
    run: Annotated[Path | None, typer.Option(help="Run or checkpoint folder. Default: the newest run.")] = None,
    checkpoint: Annotated[str, typer.Option(help="Which of the run's checkpoints.")] = "last",
    driver: Annotated[
        str | None, typer.Option(help="Instead of a run's policy: autopilot, idle, random or untrained.")
    ] = None,
    recipe: Annotated[str | None, typer.Option(help="World of a --driver. Default: highway as it comes.")] = None,
    episodes: Annotated[int, typer.Option(help="For each map and density.")] = 20,
    workers: Annotated[int | None, typer.Option(help="Processes. Default: one per core.")] = None,
    seed: Annotated[int, typer.Option(help="Of routes and traffic.")] = 0,
    device: Annotated[str, typer.Option(help="Of the policy: auto, cpu or cuda.")] = "auto",
    out: Annotated[Path | None, typer.Option(help="Where to write. Default: RUN/eval/MAPS-DENSITY[-WEATHER].")] = None,
    json: Annotated[str | None, typer.Option(help="Write the figures here too.", metavar="FILE|-")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the rows here too.", metavar="FILE")] = None,
    picture: Annotated[Path | None, typer.Option(help="Write the picture here too.", metavar="FILE")] = None,
) -> None:
    """Drive episodes on maps and report the metrics of each."""
    for name, value, least in (("--episodes", episodes, 1), ("--workers", workers, 0), ("--seed", seed, 0)):
        if value is not None and value < least:
            raise UserError(f"{value} is too few" if least else f"{value} is negative", where=name)
    from me3bev_cli.evaluation.session import prepare

    evaluation = prepare(
        run=run, checkpoint=checkpoint, driver=driver, recipe=recipe, device=device,
        maps=maps, density=density, weather=weather, episodes=episodes, seed=seed, out=out,
    )  # fmt: skip
    outcome = _play(evaluation, workers)
    written = outcome.write(evaluation.out)
    written += _copies(outcome, json, csv, picture)
    _print(outcome, evaluation, json, written)


def _play(evaluation: Evaluation, workers: int | None) -> Outcome:
    """Play the episodes; Ctrl-C says what is lost."""
    from me3bev_cli.evaluation.progress import EvaluationProgress
    from me3bev_cli.evaluation.session import play
    from me3bev_cli.workers import cores

    with EvaluationProgress(evaluation.total) as progress:
        try:
            return play(evaluation, cores() if workers is None else workers, progress)
        except KeyboardInterrupt:
            done = f"{progress.episodes} of {progress.total} episodes were finished"
    typer.echo(f"me3bev: stopped: {done}; nothing is written", err=True)
    raise typer.Exit(130)


def _copies(outcome: Outcome, json: str | None, csv: Path | None, picture: Path | None) -> list[Path]:
    """What was asked for beside the folder."""
    from me3bev_cli.files import atomic_write_bytes, atomic_write_text
    from me3bev_cli.output import STDOUT, write_json

    written = []
    if json is not None:
        write_json(outcome.document, json)
        written += [Path(json)] if json != STDOUT else []
    if csv is not None:
        atomic_write_text(csv, outcome.csv)
        written.append(csv)
    if picture is not None:
        atomic_write_bytes(picture, outcome.picture)
        written.append(picture)
    return written


def _print(outcome: Outcome, evaluation: Evaluation, json: str | None, written: list[Any]) -> None:
    from rich.markup import escape

    from me3bev_cli.evaluation.tables import tables, weather_tables
    from me3bev_cli.output import console

    place = console(json)
    for headline, table in [*tables(outcome.rows), *weather_tables(outcome.weather_rows)]:
        place.print(headline, style="bold", markup=False)
        place.print(table)
    place.print(f"↑ higher is better, ↓ lower; in brackets the 95 % interval. Seed {evaluation.seed}; {outcome.pace}")
    for path in written:
        place.print(f"wrote {escape(str(path))}", soft_wrap=True)
