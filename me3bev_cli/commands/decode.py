"""`me3bev decode`: what a policy's latent still knows of the scene, drawn and scored."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer


def decode(
    run: Annotated[Path | None, typer.Argument(help="A run. Default: the newest, else pretrained.")] = None,
    evaluate: Annotated[
        bool, typer.Option("--eval", help="Only score; a decoder that lacks is trained first.")
    ] = False,
    compare: Annotated[
        tuple[Path, Path] | None,
        typer.Option(help="Two runs: whose memory keeps what is hidden now.", metavar="RUN_A RUN_B"),
    ] = None,
    logs: Annotated[Path | None, typer.Option(help="Frames from these logs instead of live episodes.")] = None,
    mapping: Annotated[Path | None, typer.Option(help="YAML that names the topics of logs that are not ours.")] = None,
    maps: Annotated[
        str | None, typer.Option(help="Maps of the live episodes. Default: the recipe's; every map with --eval.")
    ] = None,
    density: Annotated[str | None, typer.Option(help="Density of the live episodes. Default: the recipe's.")] = None,
    weather: Annotated[
        str | None,
        typer.Option(help="As clear_noon,night or all. Default: the recipe's; its evaluation set for scoring."),
    ] = None,
    episodes: Annotated[
        int | None, typer.Option(help="Live episodes: 40, a fifth of them held out; of each map with --eval: 4.", min=1)
    ] = None,
    source: Annotated[str | None, typer.Option(help="u_bev, grid or both. Default: u_bev.")] = None,
    steps: Annotated[int | None, typer.Option(help="Minibatches at most. Default: 1000.", min=1)] = None,
    batch: Annotated[int | None, typer.Option(help="Frames per minibatch. Default: 8.", min=2)] = None,
    every: Annotated[int | None, typer.Option(help="Of so many frames one is kept. Default: 4.", min=1)] = None,
    patience: Annotated[
        int | None,
        typer.Option(help="Rounds of 50 steps without a better score. Default: 8.", min=1),
    ] = None,
    memory: Annotated[int | None, typer.Option(help="MB of latents, at most. Default: 1000.", min=1)] = None,
    pretrained: Annotated[
        str | None,
        typer.Option(help="ResNet-18's weights: true, false or a file. Default: false."),
    ] = None,
    untrained: Annotated[
        bool | None,
        typer.Option("--untrained/--no-untrained", help="Decode an untrained encoder beside it."),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Train a decoder that is there anew.")] = False,
    checkpoint: Annotated[
        str | None, typer.Option(help="last, best or a name. Default: the decoder's, or last.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of frames and training. Default: 0.", min=0)] = None,
    out: Annotated[Path | None, typer.Option(help="Where the decoder is kept. Default: RUN/decode.")] = None,
    panel: Annotated[
        Path | None,
        typer.Option(help="Cameras, truth and decoded map: frames as .png, an episode as .webp.", metavar="FILE"),
    ] = None,
    frames: Annotated[str, typer.Option(help="For the panel: worst, random, worst:N, or numbers as 3,17.")] = "worst",
    mcap: Annotated[
        Path | None, typer.Option(help="Copies of --logs with the decoded map: a folder or a file.")
    ] = None,
    json: Annotated[str | None, typer.Option(help="Write the scores.", metavar="FILE|-")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write the scores as CSV.", metavar="FILE")] = None,
) -> None:
    """Decode a policy's latent to a semantic map: train the decoder, score it, draw it.

    The same command goes on where it was stopped.
    """
    from me3bev_cli.allocator import keep_freed_memory
    from me3bev_cli.decoding import settings

    keep_freed_memory()
    given = settings.Settings(
        logs=logs, mapping=mapping, maps=maps, density=density, weather=weather, episodes=episodes, source=source,
        steps=steps, batch=batch, every=every, patience=patience, memory=memory, pretrained=pretrained,
        untrained=untrained, overwrite=overwrite, checkpoint=checkpoint, seed=seed, out=out, panel=panel, frames=frames,
        mcap=mcap,
    )  # fmt: skip
    given.check(evaluate, comparing=compare is not None, run=run)
    if compare is not None:
        _show(settings.compare(compare, given, _say), json, csv, comparison=True)
        return
    result = settings.decode(run, given, evaluate, _say)
    _show(result, json, csv, comparison=False)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _show(result: dict[str, Any], json: str | None, csv: Path | None, *, comparison: bool) -> None:
    from me3bev_cli.decoding import report
    from me3bev_cli.files import atomic_write_text
    from me3bev_cli.output import console, write_json

    show = report.print_comparison if comparison else report.print_result
    show(result, console(json))
    if json is not None:
        write_json(result, json)
    if csv is not None:
        atomic_write_text(csv, report.comparison_csv(result) if comparison else report.csv_text(result))
