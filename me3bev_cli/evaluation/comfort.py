"""Comfort as Bench2Drive defines it: the share of two-second segments that stay inside six bounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from me3bev_cli import comfort_bounds

Floats = NDArray[np.float64]

SEGMENT = 20
"""Frames of a segment; what remains at the end of an episode is dropped."""
WINDOW, ORDER = 7, 2
"""Of the Savitzky-Golay filter."""


BOUNDS = {
    "longitudinal acceleration": comfort_bounds.ACCELERATION,
    "lateral acceleration": (-comfort_bounds.LATERAL, comfort_bounds.LATERAL),
    "jerk": (-comfort_bounds.JERK, comfort_bounds.JERK),
    "longitudinal jerk": (-comfort_bounds.LONGITUDINAL_JERK, comfort_bounds.LONGITUDINAL_JERK),
    "yaw rate": (-comfort_bounds.YAW_RATE, comfort_bounds.YAW_RATE),
    "yaw acceleration": (-comfort_bounds.YAW_ACCELERATION, comfort_bounds.YAW_ACCELERATION),
}
"""Open intervals that every frame of a comfortable segment stays in."""


def savitzky_golay(values: Floats, spacing: float = 1.0, derivative: int = 0) -> Floats:
    """Local least-squares parabola: its value or first derivative at each sample.

    Each sample is judged by the window of `WINDOW` around it; the first and last three by the first and the
    last whole window. Fewer samples than `WINDOW` are one window.

    Args:
        values: (T,) with T > `ORDER`, evenly spaced.
        spacing: between two samples.
        derivative: 0 or 1.
    """
    window = min(WINDOW, len(values))
    half = window // 2
    offsets = np.arange(-half, window - half)
    # Row k of `fit` gives the coefficient of offset^k of the parabola through a window.
    fit = np.linalg.pinv(np.vander(offsets.astype(np.float64), ORDER + 1, increasing=True))
    centre = np.clip(np.arange(len(values)), half, len(values) - window + half)
    at = np.arange(len(values)) - centre
    windows = values[centre[:, None] + offsets]
    coefficients = windows @ fit.T
    if derivative == 0:
        return np.asarray(coefficients[:, 0] + coefficients[:, 1] * at + coefficients[:, 2] * at**2)
    return np.asarray((coefficients[:, 1] + 2 * coefficients[:, 2] * at) / spacing)


def motion(longitudinal: Floats, lateral: Floats, yaw_rate: Floats, spacing: float) -> dict[str, Floats]:
    """The smoothed quantities of one segment, each (T,), named as in `BOUNDS`.

    Accelerations (m/s^2) and yaw rate (rad/s) are in the vehicle's frame; their derivatives come from the same
    local parabolas.
    """
    jerk_x = savitzky_golay(longitudinal, spacing, 1)
    jerk_y = savitzky_golay(lateral, spacing, 1)
    return {
        "longitudinal acceleration": savitzky_golay(longitudinal),
        "lateral acceleration": savitzky_golay(lateral),
        "jerk": np.hypot(jerk_x, jerk_y),
        "longitudinal jerk": jerk_x,
        "yaw rate": savitzky_golay(yaw_rate),
        "yaw acceleration": savitzky_golay(yaw_rate, spacing, 1),
    }


def comfortable(longitudinal: Floats, lateral: Floats, yaw_rate: Floats, spacing: float) -> bool:
    """Whether one segment stays strictly inside all six bounds."""
    return _inside(motion(longitudinal, lateral, yaw_rate, spacing))


def comfortable_share(longitudinal: Floats, lateral: Floats, yaw_rate: Floats, spacing: float) -> float:
    """The share of comfortable segments; NaN when there is no whole segment."""
    starts = range(0, len(longitudinal) - SEGMENT + 1, SEGMENT)
    passed = [
        comfortable(longitudinal[s : s + SEGMENT], lateral[s : s + SEGMENT], yaw_rate[s : s + SEGMENT], spacing)
        for s in starts
    ]
    return float(np.mean(passed)) if passed else float("nan")


def published_share(longitudinal: Floats, lateral: Floats, yaw_rate: Floats, spacing: float) -> float:
    """The share of comfortable segments as Bench2Drive's published tool finds it, its slips included.

    An episode of at most `SEGMENT` frames is judged as one segment; NaN under three frames, which the tool refuses.
    """
    frames = len(longitudinal)
    if frames <= ORDER:
        return float("nan")
    starts = [0] if frames <= SEGMENT else range(0, frames - SEGMENT + 1, SEGMENT)
    segments = [slice(start, start + SEGMENT) for start in starts]
    return float(np.mean([_published(longitudinal[s], lateral[s], yaw_rate[s], spacing) for s in segments]))


def _published(longitudinal: Floats, lateral: Floats, yaw_rate: Floats, spacing: float) -> bool:
    turns = np.append(0.0, np.cumsum(np.round(np.diff(yaw_rate) / (2 * np.pi))))
    turning = savitzky_golay(yaw_rate - 2 * np.pi * turns)
    along = savitzky_golay(longitudinal)
    size = savitzky_golay(np.hypot(longitudinal, lateral))
    measured = {
        "longitudinal acceleration": along,
        "lateral acceleration": savitzky_golay(lateral),
        "jerk": savitzky_golay(size, spacing, 1),
        "longitudinal jerk": savitzky_golay(along, spacing, 1),
        "yaw rate": turning,
        "yaw acceleration": turning,
    }
    return _inside(measured)


def _inside(measured: dict[str, Floats]) -> bool:
    return all(bool(np.all((low < measured[name]) & (measured[name] < high))) for name, (low, high) in BOUNDS.items())
