"""Maps and densities as options name them."""

from __future__ import annotations

import pytest

from me3bev_cli.errors import MapError
from me3bev_cli.evaluation.maps import parse_densities, parse_maps, parse_weathers, shorten

TOWNS = [*(f"T{i}" for i in range(1, 8)), "Town01", "Town02", "old-town", "A-1"]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("T1-T7", ["T1", "T2", "T3", "T4", "T5", "T6", "T7"]),
        ("T2-4", ["T2", "T3", "T4"]),
        ("T3", ["T3"]),
        ("T3, T1,T3", ["T3", "T1"]),
        ("T3,T1-T3", ["T3", "T1", "T2"]),
        ("Town01-Town02", ["Town01", "Town02"]),
        ("old-town,A-1", ["old-town", "A-1"]),
        ("all", TOWNS),
    ],
)
def test_maps(text: str, names: list[str]) -> None:
    assert parse_maps(text, TOWNS) == names


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("T1-T9", "--maps: unknown map 'T8'. Allowed: A-1, T1, T2"),
        ("old-twon", "--maps: unknown map 'old-twon'; did you mean 'old-town'"),
        ("T7-T1", "--maps: the range 'T7-T1' runs backwards. Allowed: T1-T7"),
        ("T1-Town02", "goes from one kind of name to another. Allowed: as T1-T7"),
        (" , ", "--maps: no name is given"),
        ("T1-T99999999999", "unknown map 'T8'"),
    ],
)
def test_wrong_maps(text: str, message: str) -> None:
    with pytest.raises(MapError) as caught:
        parse_maps(text, TOWNS)
    assert message in str(caught.value)


def test_weathers() -> None:
    names = ("clear", "night", "fog")
    sets = {"training": ("clear",), "evaluation": ("fog", "clear")}
    assert parse_weathers("night, clear", names, {}) == ["night", "clear"]
    assert parse_weathers("all", names, {}) == list(names)
    assert parse_weathers("evaluation,night,training", names, sets) == ["fog", "clear", "night"]
    with pytest.raises(MapError, match=r"^--weather: unknown weather 'trainign'; did you mean 'training'\?"):
        parse_weathers("trainign", names, sets)
    with pytest.raises(MapError, match="there is no recipe that has a set for training"):
        parse_weathers("training", names, {})


def test_densities() -> None:
    assert parse_densities("high,low", ("low", "high")) == ["high", "low"]
    assert parse_densities("all", ("low", "high")) == ["low", "high"]
    with pytest.raises(MapError, match="--density: unknown density 'hgih'; did you mean 'high'"):
        parse_densities("hgih", ("low", "high"))


def test_short_names_mean_the_same() -> None:
    for names in (["T1", "T2", "T3"], ["T1", "T3"], ["T1", "T2"], ["Town01", "Town02"], ["old-town", "A-1", "T1"]):
        assert parse_maps(shorten(names), TOWNS) == names
    assert shorten([f"T{i}" for i in range(1, 8)]) == "T1-T7"
