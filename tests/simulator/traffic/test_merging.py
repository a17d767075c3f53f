"""Two lanes that become one outside junctions: vehicles file in alternately."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from simulator.traffic.stage import FAR_AWAY, box, ego_on, overlap, staged

from me3bev_plugins.simulator.highway.town import Lane, Town


def funnel() -> Town:
    """Two lanes of 200 m to the east; the right one bends over to the end of the left one, where both become one."""
    x = np.linspace(0.0, 200.0, 401)
    aside = 1.75 * (1.0 + np.cos(np.pi * np.clip((x - 160.0) / 40.0, 0.0, 1.0)))
    left, right = (np.column_stack([x, y, 0.0 * x]) for y in (0.0 * x, -aside))
    after = np.column_stack([np.linspace(200.0, 900.0, 701), np.zeros(701), np.zeros(701)])
    return Town(
        "funnel",
        (
            Lane(0, left, 3.5, 16.0, (2,), right=1),
            Lane(1, right, 3.5, 16.0, (2,), left=0),
            Lane(2, after, 3.5, 16.0, (), (0, 1)),
        ),
        (),
    )


@pytest.mark.parametrize("shift", [-3.0, 0.0, 1.0, 5.0])
@pytest.mark.parametrize("speed", [6.0, 15.0])
def test_abreast_at_the_end_of_a_lane(shift: float, speed: float) -> None:
    town = funnel()
    rows = [(0, 90.0, speed), (0, 65.0, speed), (0, 40.0, speed)]
    rows += [(1, 90.0 + shift, speed), (1, 65.0 + shift, speed), (1, 40.0 + shift, speed)]
    traffic = staged(town, rows)
    path = ego_on(town, [0], 5.0)[1]
    hardest = 0.0
    for _ in range(400):
        traffic.step(0.1, FAR_AWAY, path)
        boxes = [box(traffic.actors, i) for i in range(6)]
        assert not any(overlap(a, b) for a, b in combinations(boxes, 2))
        hardest = min(hardest, float(traffic._fleet.cars["accel"][:6].min()))
    assert (traffic._fleet.path[:6, 0] == 2).all()
    order = np.argsort(-traffic.actors.x[:6])
    assert [int(i >= 3) for i in order] in ([0, 1, 0, 1, 0, 1], [1, 0, 1, 0, 1, 0])
    assert hardest > -7.0
