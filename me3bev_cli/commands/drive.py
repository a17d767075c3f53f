"""`me3bev drive`: drive, and watch it: cameras, plan and semantic truth in one video."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from me3bev_cli.errors import UserError

if TYPE_CHECKING:
    from me3bev_cli.driving.session import Plan
    from me3bev_cli.driving.video import Video
    from me3bev_cli.evaluation.episode import Episode
    from me3bev_cli.stopping import Stop

VIDEO = "--video"


class DriveCommand(TyperCommand):
    """Lets `--video` stand alone."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Give a bare `--video` an empty value: the usual name."""
        words: list[str] = []
        for word in args:
            if words and words[-1] == VIDEO and word.startswith("--"):
                words.append("")
            words.append(word)
        if words and words[-1] == VIDEO:
            words.append("")
        return super().parse_args(ctx, words)


def drive(
    map: Annotated[str | None, typer.Option(help="Default: the recipe's, or the first.")] = None,
    density: Annotated[str | None, typer.Option(help="Default: the recipe's, or the first.")] = None,
    weather: Annotated[
        str | None, typer.Option(help="As night or rain,fog: each episode draws one. Default: as in eval.")
    ] = None,
    driver: Annotated[str | None, typer.Option(help="autopilot, idle, random, untrained, or a run.")] = None,
    run: Annotated[
        Path | None, typer.Option(help="A run or checkpoint. Default: the newest run, else `pretrained`.")
    ] = None,
    checkpoint: Annotated[str, typer.Option(help="Which of the run's checkpoints.")] = "last",
    recipe: Annotated[str | None, typer.Option(help="World of a --driver. Default: highway as it comes.")] = None,
    simulator: Annotated[str | None, typer.Option(help="Another than the recipe's.")] = None,
    episodes: Annotated[int, typer.Option(help="One after the other: those that eval scores.")] = 1,
    seed: Annotated[int, typer.Option(help="Of routes and traffic.")] = 0,
    steps: Annotated[int | None, typer.Option(help="Of an episode at most, 10 a second.")] = None,
    stop: Annotated[
        bool, typer.Option("--stop/--no-stop", help="End at a collision and at the horizon, or drive on.")
    ] = True,
    video: Annotated[
        str | None,
        typer.Option(help="mp4 or webm. Bare: drive-MAP-DRIVER.mp4. Left out: only drive.", metavar="[FILE]"),
    ] = None,
    camera_size: Annotated[
        str | None, typer.Option(help="As 256x704, for drivers that do not look.", metavar="HxW")
    ] = None,
    device: Annotated[str, typer.Option(help="Of the policy: auto, cpu or cuda.")] = "auto",
) -> None:
    """Drive and write a video of cameras, plan and semantic truth."""
    for name, value, least in (("--episodes", episodes, 1), ("--steps", steps, 1), ("--seed", seed, 0)):
        if value is not None and value < least:
            raise UserError(f"{value} is too few" if least else f"{value} is negative", where=name)
    from me3bev_cli.driving.session import prepare

    plan = prepare(
        driver=driver, run=run, checkpoint=checkpoint, recipe=recipe, device=device, simulator=simulator,
        map=map, density=density, weather=weather, camera_size=camera_size, seed=seed, episodes=episodes,
        steps=steps, stop=stop, video=video,
    )  # fmt: skip
    _run(plan)


def _run(plan: Plan) -> None:
    """Drive and write; Ctrl-C says what is kept."""
    from me3bev_cli.allocator import keep_freed_memory
    from me3bev_cli.driving.session import SIZE
    from me3bev_cli.driving.video import video_file
    from me3bev_cli.stopping import Stop

    keep_freed_memory()
    request = Stop()
    kept = "nothing is written"
    with request.listening():
        if plan.video is None:
            _drive(plan, None, request)
        else:
            with video_file(plan.video, *SIZE) as file:
                _drive(plan, file, request)
            if file.frames:
                kept = _written(file)
    if request.asked:
        typer.echo(f"me3bev: stopped: {kept}", err=True)
        raise typer.Exit(130)
    if plan.video is not None:
        typer.echo(kept)


def _drive(plan: Plan, file: Video | None, request: Stop) -> None:
    """Drive the episodes and print what became of each; without a video, the figures of all at the end."""
    from me3bev_cli.driving.film import Film
    from me3bev_cli.driving.outcome import outcome_line
    from me3bev_cli.driving.progress import DriveProgress
    from me3bev_cli.driving.session import play

    film = None if file is None else Film(file, plan.world.observation.cameras)
    progress = DriveProgress(plan.episodes, plan.longest)
    episodes: list[Episode] = []
    try:
        for episode in play(plan, film, request, progress):
            episodes.append(episode)
            typer.echo(outcome_line(episode))
    finally:
        progress.clear()
    if film is None and episodes:
        _figures(episodes)


def _figures(episodes: list[Episode]) -> None:
    from me3bev_cli.evaluation.summary import summarise
    from me3bev_cli.evaluation.tables import tables
    from me3bev_cli.output import console

    place = console()
    for headline, table in tables(summarise(episodes)):
        place.print(headline, style="bold", markup=False)
        place.print(table)


def _written(file: Video) -> str:
    from me3bev_cli.driving.video import RATE

    if file.encoder.note:
        typer.echo(f"me3bev: {file.encoder.note}", err=True)
    size = file.path.stat().st_size / 1e6
    return f"wrote {file.path}: {file.frames} frames, {file.frames / RATE:.1f} s, {size:.1f} MB"
