"""The filter against numpy's own least squares, and each of the six bounds by itself."""

from __future__ import annotations

import numpy as np
import pytest

from me3bev_cli.evaluation.comfort import comfortable, comfortable_share, motion, published_share, savitzky_golay

DT = 0.1
REST = np.zeros(20)
TIME = DT * np.arange(20)


@pytest.mark.parametrize("derivative", [0, 1])
def test_the_filter_fits_a_parabola_in_each_window(derivative: int) -> None:
    values = np.random.default_rng(0).normal(size=20)
    expected = []
    for i in range(20):
        first = min(max(i - 3, 0), 13)
        window = np.arange(first, first + 7)
        parabola = np.poly1d(np.polyfit(DT * window, values[window], 2))
        expected.append(parabola.deriv(derivative)(DT * i) if derivative else parabola(DT * i))
    np.testing.assert_allclose(savitzky_golay(values, DT, derivative), expected, atol=1e-9)


def test_the_filter_has_the_published_weights() -> None:
    # Savitzky and Golay's table for a quadratic over 7 points: (-2, 3, 6, 7, 6, 3, -2) / 21; slope (-3..3) / 28.
    impulse = np.zeros(21)
    impulse[10] = 1.0
    np.testing.assert_allclose(savitzky_golay(impulse)[7:14] * 21, [-2, 3, 6, 7, 6, 3, -2], atol=1e-12)
    np.testing.assert_allclose(savitzky_golay(impulse, 1.0, 1)[7:14] * 28, [3, 2, 1, 0, -1, -2, -3], atol=1e-12)


def test_the_filter_keeps_parabolas() -> None:
    np.testing.assert_allclose(savitzky_golay(3 - 2 * TIME + TIME**2), 3 - 2 * TIME + TIME**2, atol=1e-12)
    np.testing.assert_allclose(savitzky_golay(3 - 2 * TIME + TIME**2, DT, 1), -2 + 2 * TIME, atol=1e-10)


def test_jerk_is_the_length_of_the_vector() -> None:
    found = motion(3 * TIME, 4 * TIME, -2 * TIME, DT)
    np.testing.assert_allclose(found["jerk"], 5.0)
    np.testing.assert_allclose(found["longitudinal jerk"], 3.0)
    np.testing.assert_allclose(found["yaw acceleration"], -2.0)


@pytest.mark.parametrize(
    ("longitudinal", "lateral", "yaw_rate", "passes"),
    [
        (REST + 2.39, REST, REST, True),
        (REST + 2.41, REST, REST, False),
        (REST - 4.04, REST, REST, True),
        (REST - 4.06, REST, REST, False),
        (REST, REST + 4.88, REST, True),
        (REST, REST + 4.90, REST, False),
        (REST, REST - 4.90, REST, False),
        (REST, REST, REST + 0.94, True),
        (REST, REST, REST - 0.96, False),
    ],
)
def test_each_bound(longitudinal: np.ndarray, lateral: np.ndarray, yaw_rate: np.ndarray, passes: bool) -> None:
    assert comfortable(longitudinal, lateral, yaw_rate, DT) is passes


def wave(slope: float) -> np.ndarray:
    """A short ramp of the given slope between two levels: seven samples, so that the filter sees it whole."""
    ramp = np.clip(TIME - TIME[6], 0.0, DT * 8)
    return slope * (ramp - DT * 4)


@pytest.mark.parametrize(("slope", "passes"), [(4.0, True), (4.3, False), (-4.3, False)])
def test_the_bound_on_longitudinal_jerk(slope: float, passes: bool) -> None:
    assert np.abs(savitzky_golay(wave(slope), DT, 1)).max() == pytest.approx(abs(slope))
    assert comfortable(wave(slope), REST, REST, DT) is passes


@pytest.mark.parametrize(("slope", "passes"), [(8.2, True), (8.5, False)])
def test_the_bound_on_the_jerk_vector(slope: float, passes: bool) -> None:
    assert comfortable(REST, wave(slope), REST, DT) is passes


@pytest.mark.parametrize(("slope", "passes"), [(1.9, True), (2.0, False)])
def test_the_bound_on_yaw_acceleration(slope: float, passes: bool) -> None:
    assert comfortable(REST, REST, wave(slope), DT) is passes


def test_an_episode_shorter_than_a_segment_says_nothing() -> None:
    assert np.isnan(comfortable_share(REST[:19], REST[:19], REST[:19], DT))
    assert comfortable_share(REST, REST, REST, DT) == 1.0


def published(longitudinal: np.ndarray = REST, lateral: np.ndarray = REST, yaw_rate: np.ndarray = REST) -> float:
    return published_share(longitudinal, lateral, yaw_rate, DT)


def test_the_published_tool_takes_the_yaw_rate_for_the_yaw_acceleration() -> None:
    # 2 rad/s^2 breaks the bound of 1.93; the rate itself stays within 0.9.
    turn = 2.0 * np.clip(TIME - 0.6, 0.0, 0.8) - 0.8
    assert not comfortable(REST, REST, turn, DT)
    assert published(yaw_rate=turn) == 1
    assert published(yaw_rate=REST + 0.96) == 0


def test_the_published_tool_takes_the_rate_of_the_size_for_the_jerk() -> None:
    # From one side to the other with 9 m/s^3: the size only dips from 3.6 m/s^2 to 0 and comes back.
    swerve = wave(9.0)
    assert not comfortable(REST, swerve, REST, DT)
    assert np.abs(savitzky_golay(savitzky_golay(np.abs(swerve)), DT, 1)).max() < 8.37
    assert published(lateral=swerve) == 1


def test_the_published_tool_smooths_twice() -> None:
    # A kick of one frame: its slope is 3 / 28 / 0.1 s of its height; smoothed before, less.
    kick = REST.copy()
    kick[10] = 4.5
    assert np.abs(savitzky_golay(kick, DT, 1)).max() == pytest.approx(4.5 * 3 / 28 / DT)
    assert not comfortable(kick, REST, REST, DT)
    assert np.abs(savitzky_golay(savitzky_golay(kick), DT, 1)).max() < 4.13
    assert published(longitudinal=kick) == 1


def test_the_published_tool_judges_a_short_episode_as_one_segment() -> None:
    brake = REST - 5.0
    assert published_share(REST[:5], REST[:5], REST[:5], DT) == 1
    assert published_share(brake[:5], REST[:5], REST[:5], DT) == 0
    assert np.isnan(published_share(REST[:2], REST[:2], REST[:2], DT))
    # 45 frames: two segments, the rest of five is dropped.
    long = np.concatenate([brake, REST, brake[:5]])
    assert published_share(long, 0 * long, 0 * long, DT) == 0.5


def test_the_published_tool_unwraps_yaw_rates() -> None:
    # A jump of more than pi is taken for a full turn: 6.3 rad/s count as 6.3 - 2 pi.
    spin = np.where(np.arange(20) < 10, 0.0, 6.3)
    assert not comfortable(REST, REST, spin, DT)
    assert published(yaw_rate=spin) == 1
