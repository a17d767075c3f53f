"""Scores by mask, and what is drawn from them."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_cli.decoding.counting import Counts
from me3bev_cli.decoding.evaluating import Album, Scored, Shot, Wanted, rows_of, weather_rows
from me3bev_cli.decoding.moments import UNKNOWN, Moment, Take, live_takes
from me3bev_cli.decoding.scores import confusion, iou


def test_iou_by_hand() -> None:
    truth = np.array([[1, 1, 6, 0]], np.uint8)
    decoded = np.array([[1, 6, 6, 0]], np.uint8)
    values = iou(confusion(truth, decoded))
    # Road: one hit of two that either has; vehicle: one of two; other: one of one; the rest is in neither.
    assert values[[1, 6, 0]].tolist() == [0.5, 0.5, 1.0]
    assert np.isnan(values[2])


def test_masks_agree_with_masks_made_cell_by_cell() -> None:
    rng = np.random.default_rng(0)
    truth, decoded = rng.integers(0, 8, (2, 200, 200), np.uint8)
    seen = rng.random((200, 200)) < 0.3
    counts = Counts()
    counts.add(truth, decoded, seen)
    metres = (np.arange(200) - 99.5) * 0.5
    far = np.sqrt(metres[:, None] ** 2 + metres[None] ** 2)
    near = (np.abs(metres)[:, None] < 25) & (np.abs(metres)[None] < 25)
    masks = {
        "all": np.ones((200, 200), bool), "seen": seen, "near": near, "0-15": far < 15,
        "15-30": (far >= 15) & (far < 30), "30-50": (far >= 30) & (far < 50),
    }  # fmt: skip
    assert counts.masks() == list(masks)
    for name, mask in masks.items():
        assert np.array_equal(counts.confusion(name), confusion(truth, decoded, mask)), name


def test_frames_of_unknown_sight_have_no_seen_cells() -> None:
    counts = Counts()
    counts.add(np.zeros((200, 200), np.uint8), np.zeros((200, 200), np.uint8), None)
    assert "seen" not in counts.masks()
    assert counts.mean() == 1.0


def _scored() -> Scored:
    """Two episodes on two maps: road found wholly on A, half on B; no other class there."""
    found = []
    for hit in (200, 100):
        decoded = np.zeros((200, 200), np.uint8)
        decoded[:hit] = 1
        counts = Counts()
        counts.add(np.ones((200, 200), np.uint8), decoded, None)
        found.append({"u_bev": counts})
    return Scored([Take("a", "A", "sun"), Take("b", "B", "sun")], found)


def test_rows_are_of_each_map_and_their_mean() -> None:
    rows = {(r["mask"], r["map"], r["class"]): r["iou"] for r in rows_of(_scored(), "u_bev", source="u_bev")}
    assert [rows["all", place, "road"] for place in ("A", "B", "mean")] == [1.0, 0.5, 0.75]
    # B: other is decoded and never true; road half found.
    assert rows["all", "B", "mean"] == 0.25
    assert np.isnan(rows["all", "mean", "vehicle"])


def test_rows_by_weather_pool_the_maps() -> None:
    rows = {(r["mask"], r["weather"], r["class"]): r["iou"] for r in weather_rows(_scored(), "u_bev", source="u_bev")}
    assert rows["all", "sun", "road"] == 0.75


def test_every_map_sees_every_weather() -> None:
    takes = live_takes(["A", "B"], "low", ["sun", "rain"], 4, 0, "score")
    assert [(take.map, take.weather) for take in takes] == [("A", "sun"), ("B", "rain"), ("A", "rain"), ("B", "sun")]
    assert len({take.seed for take in takes}) == 4


def _shot(number: int, score: float) -> Shot:
    empty = np.zeros((200, 200), np.uint8)
    moment = Moment(np.zeros((1, 3, 8, 8), np.uint8), empty, None, UNKNOWN, 0.0)
    return Shot(Take("a", "A", "sun"), 40 * number, number, score, moment, {})


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [(Wanted("worst", 2), [1, 3]), (Wanted("chosen", 0, (0, 2)), [0, 2])],
)
def test_an_album_keeps_the_frames_that_are_wanted(wanted: Wanted, expected: list[int]) -> None:
    album = Album(wanted)
    for number, score in enumerate((0.9, 0.1, 0.8, 0.2)):
        album.see(_shot(number, score))
    assert [shot.number for shot in album.shots] == expected


def test_of_frames_that_follow_each_other_one_is_drawn() -> None:
    album = Album(Wanted("worst", 2))
    for step, score in enumerate((0.3, 0.1, 0.2)):
        album.see(_shot(0, score)._replace(step=step, number=step))
    assert [shot.step for shot in album.shots] == [1]
