"""Bench2Drive's bounds of a comfortable drive. No numpy here: rewards are described with them."""

from __future__ import annotations

ACCELERATION = (-4.05, 2.40)
"""m/s^2 along the heading."""
LATERAL = 4.89
"""m/s^2 to either side."""
JERK = 8.37
"""m/s^3, the magnitude of the vector."""
LONGITUDINAL_JERK = 4.13
"""m/s^3 along the heading, either way."""
YAW_RATE = 0.95
"""rad/s, either way."""
YAW_ACCELERATION = 1.93
"""rad/s^2, either way."""
