"""Results of a decoding as tables, CSV and rows for JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from me3bev_cli.api import BEV_CLASSES
from me3bev_cli.decoding.counting import ALL_MASKS
from me3bev_cli.decoding.plan import GRID, U_BEV

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

Rows = Sequence[Mapping[str, Any]]
CLASSES = (*BEV_CLASSES, "mean")
FIELDS = ("source", "decoder", "mask", "map", "weather", "class", "iou")
BRIEF = ("road", "lane_marking", "vehicle", "pedestrian", "mean")
TITLES = {
    "most_frequent": "most frequent class",
    "untrained": "untrained encoder",
    "perception_head": "perception head",
}


def csv_text(result: Mapping[str, Any]) -> str:
    """All rows, the baselines' and those by weather too; `all` in a column stands for no distinction."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, FIELDS, restval="all", lineterminator="\n")
    writer.writeheader()
    for row in (*result["rows"], *result["baselines"], *result["by_weather"]):
        writer.writerow({key: "" if value != value else value for key, value in row.items()})
    return buffer.getvalue()


def print_result(result: Mapping[str, Any], console: Console) -> None:
    """Tables for people: by class and mask, then by map and by weather."""
    for note in result["notes"]:
        console.print(note)
    rows = [*result["rows"], *result["baselines"]]
    sources = list(dict.fromkeys(row["source"] for row in rows))
    for source in sources:
        if source in (U_BEV, GRID):
            own = [row for row in rows if row["source"] == source]
            console.print(f"{source}: IoU of {result['frames']} frames, mean over the maps ({_by(own)})", _by_mask(own))
    beside = [source for source in sources if source not in (U_BEV, GRID)]
    if beside:
        console.print("beside it: IoU, mean over the maps", _baselines(rows, beside))
    mask = "near"
    console.print(f"by map: IoU, {mask}", _places(rows, "map", mask, result["maps"]))
    if len(result["weathers"]) > 1:
        console.print(f"by weather: IoU, {mask}", _places(result["by_weather"], "weather", mask, result["weathers"]))


def _by(rows: Rows) -> str:
    return {"resnet": "by the decoder", "perception_head": "by the head of the perception stage"}[rows[0]["decoder"]]


def _table() -> Table:
    from rich import box
    from rich.table import Table

    return Table(box=box.SIMPLE_HEAD)


def _found(rows: Rows, *keys: str) -> dict[tuple[Any, ...], float]:
    return {tuple(row.get(key) for key in keys): row["iou"] for row in rows}


def _by_mask(rows: Rows) -> Table:
    table = _table()
    found = _found([row for row in rows if row.get("map") == "mean"], "class", "mask")
    masks = [mask for mask in ALL_MASKS if any(key[1] == mask for key in found)]
    table.add_column("class")
    for mask in masks:
        table.add_column(mask if "-" not in mask else f"{mask} m", justify="right")
    for name in CLASSES:
        table.add_row(name, *(_number(found.get((name, mask))) for mask in masks))
    return table


def _baselines(rows: Rows, sources: Sequence[str]) -> Table:
    table = _table()
    found = _found([row for row in rows if row.get("map") == "mean"], "source", "class", "mask")
    masks = ("all", "near")
    table.add_column("class")
    for source in sources:
        for mask in masks:
            table.add_column(f"{TITLES.get(source, source)}\n{mask}", justify="right")
    for name in CLASSES:
        table.add_row(name, *(_number(found.get((source, name, mask))) for source in sources for mask in masks))
    return table


def _places(rows: Rows, axis: str, mask: str, places: Iterable[str]) -> Table:
    table = _table()
    found = _found([row for row in rows if row["mask"] == mask], "source", axis, "class")
    table.add_column(axis)
    table.add_column("source")
    for name in BRIEF:
        table.add_column(name, justify="right")
    for place in places:
        for source in (U_BEV, GRID):
            if (source, place, "road") in found:
                table.add_row(place, source, *(_number(found.get((source, place, name))) for name in BRIEF))
    return table


def print_comparison(result: Mapping[str, Any], console: Console) -> None:
    """Cells hidden now that were visible a moment ago, both runs and their difference."""
    for note in result["notes"]:
        console.print(note)
    a, b = result["runs"]
    frames = f"{result['frames']} frames of {result['episodes']} episodes"
    console.print(f"u_bev: IoU on {frames}; A: {a}, B: {b}; B - A with its 95 % interval over episodes")
    table = _table()
    for name in ("mask", "class", "cells", "A", "B", "B - A", "interval"):
        table.add_column(name, justify="left" if name in ("mask", "class") else "right")
    for row in result["rows"]:
        if row["mask"] != "remembered" and row["class"] not in (*BRIEF, "moving"):
            continue
        interval = f"{_number(row['low'], '+.3f')} .. {_number(row['high'], '+.3f')}"
        table.add_row(
            row["mask"], row["class"], f"{row['cells']:,}", _number(row["a"], ".3f"), _number(row["b"], ".3f"),
            _number(row["difference"], "+.3f"), interval,
        )  # fmt: skip
    console.print(table)
    console.print(
        f"remembered: hidden now, visible within the last {result['seconds']:g} s; never_seen: hidden now and then; "
        "moving: vehicle and pedestrian as one class"
    )


def _number(value: float | None, form: str = ".2f") -> str:
    return "-" if value is None or value != value else f"{value:{form}}"


def comparison_csv(result: Mapping[str, Any]) -> str:
    """The rows of a comparison."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(result["rows"][0]), lineterminator="\n")
    writer.writeheader()
    for row in result["rows"]:
        writer.writerow({key: "" if value != value else value for key, value in row.items()})
    return buffer.getvalue()
