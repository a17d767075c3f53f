"""Thresholds that an evaluation has to keep, from a YAML file: for other people's continuous integration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from me3bev_cli.errors import RecipeError, UserError, did_you_mean
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.summary import AVERAGE, Row
from me3bev_cli.recipe_faults import Fault, validate
from me3bev_cli.recipe_yaml import Node, plain, read_yaml


class Threshold(BaseModel):
    """One line of a gate."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    metric: str = Field(description="its name, as `me3bev metrics` lists it")
    at_least: float | None = Field(default=None, description="the figure may not be lower")
    at_most: float | None = Field(default=None, description="the figure may not be higher")
    map: str | None = Field(default=None, description="a map or `average`; default: the average, or the only map")
    density: str | None = Field(default=None, description="default: each that is evaluated")
    method: str | None = Field(default=None, description="default: each run, or each driver where there is no run")
    figure: Literal["mean", "low", "high"] = Field(
        default="mean", description="the mean, or an end of its 95 % interval"
    )
    version: int | None = Field(default=None, description="the metric's version that the threshold was chosen for")

    @model_validator(mode="after")
    def _bounded(self) -> Threshold:
        if self.at_least is None and self.at_most is None:
            raise ValueError("needs at_least or at_most")
        return self


class Gate(BaseModel):
    """A gate's file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    thresholds: tuple[Threshold, ...] = Field(min_length=1, description="all of them have to be kept")


@dataclass(frozen=True)
class Shortfall:
    """A threshold that a figure has not kept."""

    row: Row | None
    text: str


def read_gate(path: Path) -> Gate:
    """The gate in a file.

    Raises:
        UserError: it cannot be read.
        RecipeError: every fault in it, with file, line and key.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(f"cannot be read: {reason}", where=str(path)) from error
    tree = read_yaml(text, str(path))
    gate, faults = validate(Gate, plain(tree))
    if gate is not None:
        faults = [fault for number, one in enumerate(gate.thresholds) for fault in _unknown(number, one)]
    _refuse(faults, tree)
    found: Gate = gate
    return found


def _unknown(number: int, threshold: Threshold) -> list[Fault]:
    metric = METRICS.get(threshold.metric)
    if metric is None:
        question = did_you_mean(threshold.metric, METRICS)
        text = f"unknown metric '{threshold.metric}'"
        text += f"; {question}" if question else ""
        return [Fault(("thresholds", number, "metric"), text, ", ".join(METRICS))]
    if threshold.version not in (None, metric.version):
        where = ("thresholds", number, "version")
        return [Fault(where, f"{metric.name} has version {metric.version}, not {threshold.version}")]
    return []


def _refuse(faults: Sequence[Fault], tree: Node) -> None:
    if faults:
        raise RecipeError([fault.located(tree) for fault in faults])


def check_names(gate: Gate, path: Path, maps: Sequence[str], densities: Sequence[str], methods: Sequence[str]) -> None:
    """Raises RecipeError, before anything is driven, when a threshold names what is not evaluated."""
    known: dict[str, Sequence[str]] = {
        "map": [*maps, *([AVERAGE] if len(maps) > 1 else [])],
        "density": densities,
        "method": methods,
    }
    faults = [
        Fault(("thresholds", number, key), f"the {key} '{getattr(one, key)}' is not evaluated", ", ".join(names))
        for number, one in enumerate(gate.thresholds)
        for key, names in known.items()
        if getattr(one, key) not in (None, *names)
    ]
    if faults:
        _refuse(faults, read_yaml(path.read_text(encoding="utf-8"), str(path)))


def shortfalls(gate: Gate, rows: Sequence[Row], methods: Sequence[str]) -> list[Shortfall]:
    """What has not been kept, in the order of the thresholds; a figure that is not there has not.

    Args:
        rows: of the evaluation.
        methods: those that a threshold without a method is for.
    """
    usual = AVERAGE if any(row.map == AVERAGE for row in rows) else None
    found = []
    for one in gate.thresholds:
        judged = [
            row
            for row in rows
            if row.metric == one.metric
            and row.map == (one.map or usual or row.map)
            and row.density == (one.density or row.density)
            and row.method in (methods if one.method is None else (one.method,))
        ]
        if not judged:
            found.append(Shortfall(None, f"{one.metric}: there is no figure"))
        found += [Shortfall(row, text) for row in judged if (text := _judge(one, row)) is not None]
    return found


def _judge(one: Threshold, row: Row) -> str | None:
    value: float = getattr(row, one.figure)
    where = f"{row.method}, {row.map}, {row.density}: {one.metric}"
    end = "" if one.figure == "mean" else f" ({one.figure} end of the interval)"
    if math.isnan(value):
        return f"{where}{end}: there is no figure, from {row.n} episodes"
    bounds: list[Any] = []
    if one.at_least is not None and value < one.at_least:
        bounds.append(f"at least {one.at_least:g}")
    if one.at_most is not None and value > one.at_most:
        bounds.append(f"at most {one.at_most:g}")
    return f"{where}{end} is {value:.4g}, should be {' and '.join(bounds)}" if bounds else None
