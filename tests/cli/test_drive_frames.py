"""Frames of a drive: what is drawn, and where."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from me3bev_cli.api import BEV_CLASSES, StepRecord
from me3bev_cli.driving import canvas
from me3bev_cli.driving.dashboard import LAMPS, Dashboard
from me3bev_cli.driving.frame import HEIGHT, PLAN, WIDTH, Caption, Frames, View, bev_picture, events_of
from me3bev_cli.pictures import BEV_COLOURS


def record(**values: Any) -> StepRecord:
    plain: dict[str, Any] = dict.fromkeys(StepRecord.__annotations__, 0.0)
    plain |= {"collision": "", "route_length": 50.0, "speed_limit": 10.0, "time": 0.1}
    plain |= dict.fromkeys(("at_fault", "off_road", "red_light", "stop_sign"), False)
    return plain | values  # type: ignore[return-value]


def view(record_: StepRecord, shape: tuple[int, ...] = (6, 3, 16, 44)) -> View:
    images = np.full(shape, 200, np.uint8)
    return View(images, np.ones((200, 200), np.uint8), np.full((PLAN, PLAN, 3), 90, np.uint8), record_, "green")


def frames(count: int = 6) -> Frames:
    made = Frames([f"camera_{index}" for index in range(count)])
    made.begin(Caption("T3", "high", "clear_noon", "autopilot", 0, 1, 1))
    return made


@pytest.mark.parametrize("shape", [(6, 3, 16, 44), (6, 3, 512, 704), (2, 3, 64, 64), (1, 3, 16, 400), (4, 3, 90, 90)])
def test_cameras_of_any_number_and_size_fit(shape: tuple[int, int, int, int]) -> None:
    picture = frames(shape[0]).step(view(record(), shape))
    assert (picture.shape, picture.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
    seen = (picture[48:434] == 200).all(2)
    count, _, height, width = shape
    # All of them, at their aspect, and together as large as the room allows in one direction.
    rows, columns = -(-count // min(3, count)), min(3, count)
    across, down = seen.any(0).sum(), seen.any(1).sum()
    assert across / columns / (down / rows) == pytest.approx(width / height, rel=0.03)
    assert across > 1500 or down > 370


def test_events_are_shown_for_a_second() -> None:
    made = frames()

    def has_banner(now: float, **values: Any) -> bool:
        part = made.step(view(record(time=now, **values)))[380:420, 500:1100]
        return bool((part == canvas.RED).all(2).any())

    assert not has_banner(0.1)
    assert has_banner(0.2, red_light=True)
    assert has_banner(1.1)
    assert not has_banner(1.2)


def test_what_happened_in_words() -> None:
    assert events_of(record()) == []
    said = events_of(record(collision="vehicle", at_fault=True, red_light=True, off_road=True))
    assert said == ["collision: vehicle, at fault", "ran a red light", "off the road"]
    assert events_of(record(lane_departure=True)) == ["left its lane"]
    assert events_of(record(collision="pedestrian", stop_sign=True)) == ["collision: pedestrian", "ran a stop sign"]


def test_the_map_is_in_the_colours_of_the_legend_with_the_ego_in_its_middle() -> None:
    classes = np.repeat(np.arange(8, dtype=np.uint8), 25)[:, None].repeat(200, 1)
    picture = bev_picture(classes)
    assert picture.shape == (PLAN, PLAN, 3)
    rows = (np.arange(8) + 0.5) * PLAN / 8
    np.testing.assert_array_equal(picture[rows.astype(int), 10], BEV_COLOURS)
    assert tuple(picture[PLAN // 2, PLAN // 2]) == (255, 255, 255)
    legend = Dashboard(668, PLAN).blank
    for colour in BEV_COLOURS[: len(BEV_CLASSES)]:
        assert (legend == colour).all(2).sum() > 100


@pytest.mark.parametrize("light", ["none", "red", "amber", "green", "off"])
def test_one_lamp_is_lit(light: str) -> None:
    picture = Dashboard(668, PLAN).draw(record(), light, False)[10:120, 300:360]
    lit = [name for name, colour in LAMPS.items() if (picture == colour).all(2).sum() > 200]
    assert lit == [name for name in LAMPS if name == light]


def test_bars_point_where_the_car_is_told_to_go() -> None:
    def reach(**values: Any) -> tuple[float, float]:
        """Mean column of what is blue in the row of steering and of what is green or red in the row below."""
        picture = Dashboard(668, PLAN).draw(record(**values), "none", False)
        steering = (picture[144:156] == canvas.BLUE).all(2)
        pedals = (picture[174:186] == canvas.GREEN).all(2) | (picture[174:186] == canvas.RED).all(2)
        return tuple(float(np.nonzero(part)[1].mean()) for part in (steering, pedals))  # type: ignore[return-value]

    middle = (170 + 644) / 2
    left, throttle = reach(steering=0.5, longitudinal=0.5)
    right, brake = reach(steering=-0.5, longitudinal=-0.5)
    assert left < middle < right
    assert brake < middle < throttle
    assert throttle - middle == pytest.approx(0.25 * (644 - 170) / 2, abs=2)


def test_letters_outside_the_picture_are_left_out() -> None:
    picture = np.zeros((20, 30, 3), np.uint8)
    for at in ((-15, 10), (25, 10), (10, -3), (10, 25), (300, 300), (-300, -300)):
        canvas.write(picture, at, "wide words", 16)
    assert picture.any()
