"""What was visible a moment ago, and two runs beside each other."""

from __future__ import annotations

import math

import numpy as np

from me3bev_cli.decoding.probing import PROBED, Glance, Probed, ious, probe_rows, remembered


def _glance(x: float, y: float, heading: float, *cells: tuple[int, int]) -> Glance:
    seen = np.zeros((200, 200), bool)
    for cell in cells:
        seen[cell] = True
    return Glance(0.0, (x, y, heading), seen)


def test_a_place_is_found_again_after_driving_on() -> None:
    # Row 79 is 10.25 m ahead; two metres later the same place is 8.25 m ahead, row 83.
    before, now = _glance(0.0, 0.0, 0.0, (79, 120)), _glance(2.0, 0.0, 0.0)
    mask = remembered(now, [before])
    assert np.argwhere(mask).tolist() == [[83, 120]]


def test_a_place_is_found_again_after_a_turn_to_the_left() -> None:
    # 10.25 m ahead, 0.25 m to the left; after a quarter turn to the left: 0.25 m ahead, 10.25 m to the right.
    before, now = _glance(5.0, 7.0, 0.0, (79, 99)), _glance(5.0, 7.0, math.pi / 2)
    assert np.argwhere(remembered(now, [before])).tolist() == [[99, 120]]


def test_what_is_seen_now_is_not_remembered() -> None:
    before, now = _glance(0.0, 0.0, 0.0, (79, 120), (10, 10)), _glance(0.0, 0.0, 0.0, (79, 120))
    assert np.argwhere(remembered(now, [before])).tolist() == [[10, 10]]
    assert not remembered(now, []).any()


def test_vehicle_and_pedestrian_count_as_one_class() -> None:
    counts = np.zeros((8, 8), np.int64)
    counts[6, 6], counts[6, 7], counts[7, 1] = 2, 3, 5
    values = ious(counts)
    # Vehicle: 2 of 5; both as one: 2 + 3 of 10, since what is taken for the other is still found.
    assert values[6] == 0.4
    assert values[8] == 0.5


def test_a_difference_has_an_interval_over_episodes() -> None:
    counts = np.zeros((6, 2, len(PROBED), 8, 8), np.int64)
    for episode in range(6):
        counts[episode, 0, 0, 6, 6], counts[episode, 0, 0, 6, 1] = 2, 8
        counts[episode, 1, 0, 6, 6], counts[episode, 1, 0, 6, 1] = 5 + episode % 2, 5 - episode % 2
    row = next(r for r in probe_rows(Probed(counts)) if r["mask"] == "remembered" and r["class"] == "vehicle")
    assert row["cells"] == 60
    assert (row["a"], row["b"]) == (0.2, 0.55)
    assert 0.3 <= row["low"] <= row["difference"] <= row["high"] <= 0.4
    never = next(r for r in probe_rows(Probed(counts)) if r["mask"] == "never_seen" and r["class"] == "vehicle")
    assert math.isnan(never["low"])
