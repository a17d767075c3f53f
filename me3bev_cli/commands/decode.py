"""`me3bev decode`: what a policy's latent still knows of the scene, drawn and scored."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from me3bev_cli.errors import UserError


def decode(
    run: Annotated[Path | None, typer.Argument(help="A run. Default: the newest.")] = None,
    logs: Annotated[Path | None, typer.Option(help="Frames from these logs instead of live episodes.")] = None,
    maps: Annotated[str | None, typer.Option(help="Maps of the live episodes. Default: the recipe's.")] = None,
    density: Annotated[str | None, typer.Option(help="Density of the live episodes. Default: the recipe's.")] = None,
    weather: Annotated[
        str | None,
        typer.Option(help="As clear_noon,night or all. Default: the recipe's; its evaluation set for scoring."),
    ] = None,
    episodes: Annotated[int, typer.Option(help="Live episodes; a fifth is held out for scoring.", min=2)] = 20,
    steps: Annotated[int, typer.Option(help="Minibatches to train the decoder for.", min=1)] = 400,
    batch: Annotated[int, typer.Option(help="Frames per minibatch.", min=2)] = 16,
    pretrained: Annotated[str | None, typer.Option(help="File of ResNet-18 weights to start from.")] = None,
    seed: Annotated[int, typer.Option(help="Of frames and training.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Where to write. Default: RUN/decode.")] = None,
    json: Annotated[str | None, typer.Option(help="Write the scores.", metavar="FILE|-")] = None,
) -> None:
    """Decode a policy's latent to a semantic map and score it."""
    if logs is not None and weather is not None:
        raise UserError("recorded episodes have the weather they were recorded in", where="--weather")
    from me3bev_cli.decoding.session import Plan
    from me3bev_cli.decoding.session import decode as decode_run
    from me3bev_cli.evaluation.choice import choose_weather
    from me3bev_cli.evaluation.maps import parse_maps
    from me3bev_cli.output import write_json
    from me3bev_cli.pipeline.assemble import configured
    from me3bev_cli.pipeline.control import Controller
    from me3bev_cli.training.run import open_run, require_newest_run

    folder = open_run(run) if run is not None else require_newest_run()
    controller = Controller.load(folder, device="auto")
    cls, config = configured("simulator", controller.recipe.simulator)
    simulator = cls(config)
    places = parse_maps(maps, simulator.maps()) if maps else [controller.recipe.simulator.map]
    plan = Plan(
        maps=places,
        density=density or controller.recipe.simulator.density,
        episodes=episodes,
        steps=steps,
        batch=batch,
        seed=seed,
        logs=logs,
        pretrained=pretrained,
        weather=None if weather is None else choose_weather(weather, simulator, controller.recipe, "training"),
    )
    place = out or folder / "decode"
    result = decode_run(controller, plan, place, lambda text: print(text, file=sys.stderr, flush=True))
    _print(result, json)
    print(f"picture: {place / 'panel.png'}", file=sys.stderr)
    if json is not None:
        write_json(result, json)


def _print(result: dict[str, Any], json: str | None) -> None:
    from rich import box
    from rich.table import Table

    from me3bev_cli.output import console

    table = Table(box=box.SIMPLE_HEAD, title=f"IoU on {result['frames']} held-out frames of {result['recipe']}")
    table.add_column("class")
    columns = [("u_bev", "all"), ("u_bev", "near"), ("most_frequent", "all"), ("most_frequent", "near")]
    for source, mask in columns:
        table.add_column(f"{source}\n{mask}", justify="right")
    found = {(row["source"], row["mask"], row["class"]): row["iou"] for row in result["rows"]}
    for name in dict.fromkeys(row["class"] for row in result["rows"]):
        cells = [found[(source, mask, name)] for source, mask in columns]
        table.add_row(name, *("-" if value != value else f"{value:.2f}" for value in cells))
    console(json).print(table)
