"""`me3bev logs`: what is in recorded episodes, whether they are sound, their frames as pictures."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from me3bev_cli.recording.mapping import TopicMapping

app = typer.Typer(
    help="Show, check and export recorded episodes.", no_args_is_help=True, rich_markup_mode=None, add_completion=False
)

Place = Annotated[Path, typer.Argument(help="A folder of MCAP files, or one file.", metavar="DIR|FILE")]
MappingOption = Annotated[
    Path | None, typer.Option(help="YAML that says which topics hold what, for logs of others.", metavar="FILE")
]
JsonOption = Annotated[str | None, typer.Option(help="Write the figures.", metavar="FILE|-")]


def _opened(place: Path, mapping: Path | None) -> tuple[list[Path], TopicMapping | None]:
    from me3bev_cli.recording.logfile import LogWarning
    from me3bev_cli.recording.mapping import load_mapping
    from me3bev_cli.recording.reader import log_files

    warnings.simplefilter("ignore", LogWarning)  # These commands say it themselves.
    return log_files(place), load_mapping(mapping) if mapping is not None else None


@app.command()
def info(place: Place, mapping: MappingOption = None, json: JsonOption = None) -> None:
    """Episodes, steps, maps, size and infractions."""
    from me3bev_cli.errors import LogError
    from me3bev_cli.output import console, write_json
    from me3bev_cli.recording.info import folder_info, totals

    files, topics = _opened(place, mapping)
    infos, bad = folder_info(files, topics)
    out = console(json)
    if len(files) > 1 and infos:
        out.print(_table(totals(infos)))
        size, steps = sum(one.bytes for one in infos), sum(one.steps for one in infos)
        out.print(f"{len(infos)} episodes, {steps:,} steps, {size / 1e6:,.1f} MB, {size / steps:,.0f} bytes per step")
    elif infos:
        for name, value in asdict(infos[0]).items():
            out.print(f"{name.replace('_', ' '):<16}{_cell(value)}")
    cut = [one.file for one in infos if one.ended == "cut off"]
    for name in cut:
        print(f"{name} is cut off: `me3bev logs check` says what is lost", file=sys.stderr)
    if json is not None:
        rows = [asdict(one) for one in infos]
        write_json({"rows": rows, "unreadable": {str(path): str(error) for path, error in bad}}, json)
    if bad:
        raise LogError("\n".join(str(error) for _, error in bad))


@app.command()
def check(place: Place, mapping: MappingOption = None, json: JsonOption = None) -> None:
    """Schemas, checksums, times, calibration and every frame. Exit code 2 when anything is wrong."""
    from me3bev_cli.errors import LogError
    from me3bev_cli.output import console, write_json
    from me3bev_cli.recording.check import check_logs

    files, topics = _opened(place, mapping)
    faults = check_logs(files, topics)
    wrong = {path: found for path, found in faults.items() if found}
    console(json).print(f"{len(files) - len(wrong)} of {len(files)} logs are sound")
    if json is not None:
        write_json({"rows": [{"file": str(path), "faults": found} for path, found in faults.items()]}, json)
    if wrong:
        told = [(str(path), fault) for path, found in wrong.items() for fault in found]
        raise LogError("\n".join(fault if path in fault else f"{path}: {fault}" for path, fault in told))


@app.command()
def export(
    place: Place,
    out: Annotated[Path, typer.Option(help="Folder of PNG files, or a video (.mp4, .webm).")],
    cameras: Annotated[str | None, typer.Option(help="As front,back. Default: all.")] = None,
    every: Annotated[int, typer.Option(help="Of so many frames one.", min=1)] = 1,
    mapping: MappingOption = None,
) -> None:
    """Frames as PNG files, or one video of the cameras with the semantic map beside them."""
    from me3bev_cli.driving.video import FORMATS
    from me3bev_cli.recording.export import export_pictures, export_video

    files, topics = _opened(place, mapping)
    names = [name.strip() for name in (cameras or "").split(",") if name.strip()]
    if out.suffix.lower() in FORMATS:
        print(f"{out}  {export_video(files, out, names, every, topics)} frames")
    else:
        print(f"{out}  {export_pictures(files, out, names, every, topics)} pictures")


@app.command()
def recover(
    log: Annotated[Path, typer.Argument(help="A log that was cut off, as a killed collection leaves it.")],
    out: Annotated[Path, typer.Option(help="The whole log to write.")],
) -> None:
    """Save the whole chunks of a log that was cut off as a log that viewers open."""
    from me3bev_cli.recording.export import recover as save

    _opened(log, None)
    print(f"{out}  {save(log, out)} messages")


def _table(rows: Sequence[Any]) -> Any:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 2, 0, 0))
    for name, value in asdict(rows[0]).items():
        table.add_column(name.replace("_", " "), justify="left" if isinstance(value, str) else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(value) for value in asdict(row).values()))
    return table


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:,}" if isinstance(value, int) else f"{value:.1f}" if isinstance(value, float) else str(value)
