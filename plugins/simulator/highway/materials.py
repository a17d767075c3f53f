"""What the faces of things are made of, and their colours."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Role(IntEnum):
    """What a face is made of. The first two take the thing's own colours."""

    FIRST = 0
    SECOND = 1
    GLASS = 2
    DARK = 3
    HEADLAMP = 4
    TAIL = 5
    METAL = 6
    BARK = 7
    SKIN = 8
    RED = 9
    AMBER = 10
    GREEN = 11
    SIGN_RED = 12
    SIGN_WHITE = 13
    WALL = 14
    PLATE = 15
    LEAF = 16
    """As the first, a little different from face to face."""
    LAMP = 17
    """Of a street."""
    SKIN_DARK = 18
    HAIR = 19
    RUBBER = 20


COLOURS = np.array(
    [
        (0, 0, 0),
        (0, 0, 0),
        (38, 46, 56),
        (26, 26, 28),
        (244, 244, 228),
        (150, 14, 16),
        (96, 99, 104),
        (84, 64, 48),
        (205, 160, 130),
        (255, 40, 30),
        (255, 180, 30),
        (50, 245, 110),
        (190, 22, 26),
        (240, 240, 240),
        (0, 0, 0),
        (225, 225, 215),
        (0, 0, 0),
        (255, 222, 160),
        (122, 82, 60),
        (48, 36, 30),
        (22, 22, 24),
    ],
    np.float64,
)
"""(roles, 3) r, g, b; of lamps when lit."""
