"""Our reader against CARLA's own map of the same file, where a python with the `carla` package is at hand.

`ME3BEV_CARLA_PYTHON=/path/to/python ME3BEV_XODR_DIR=/maps pytest tests/simulator/opendrive/test_carla_oracle.py`
(carla 0.9.16 and numpy in that python; the folder holds OpenDRIVE files).
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.opendrive.document import read_document
from me3bev_plugins.simulator.highway.opendrive.lanes import Network, build_network
from me3bev_plugins.simulator.highway.opendrive.shapes import Key, section_shapes
from me3bev_plugins.simulator.highway.town import Floats

PYTHON, FOLDER = os.environ.get("ME3BEV_CARLA_PYTHON"), os.environ.get("ME3BEV_XODR_DIR")
FILES = sorted(Path(FOLDER).glob("*.xodr")) if PYTHON and FOLDER else []
NEAR = 0.01
"""Metres."""


def asked(path: Path, folder: Path) -> dict[str, np.ndarray]:
    """What the client says of a file; a file that ends its process is skipped."""
    target = folder / "oracle.npz"
    script = Path(__file__).with_name("carla_oracle.py")
    done = subprocess.run([PYTHON, script, path, target], capture_output=True, text=True, timeout=600)
    if done.returncode < 0:
        pytest.skip(f"the client died of signal {-done.returncode} on {path.name}")
    assert done.returncode == 0, done.stderr
    return dict(np.load(target))


def apart(points: Floats, line: Floats) -> tuple[Floats, Floats]:
    """Metres from points (N, 3) to a centre line (P, 3): in the plane, and in height where they are nearest."""
    step = np.diff(line, axis=0)
    from_start = points[:, None] - line[None, :-1]
    share = (from_start[..., :2] * step[:, :2]).sum(-1) / (step[:, :2] ** 2).sum(-1)
    gap = from_start - np.clip(share, 0.0, 1.0)[..., None] * step
    away = np.hypot(gap[..., 0], gap[..., 1])
    nearest = away.argmin(axis=1)[:, None]
    return np.take_along_axis(away, nearest, 1)[:, 0], np.abs(np.take_along_axis(gap[..., 2], nearest, 1)[:, 0])


def followers(network: Network, known: set[Key]) -> dict[Key, set[Key]]:
    """For each known piece of the file, the known pieces that follow it, across unknown ones."""
    direct: dict[Key, set[Key]] = {}
    for lane in network.lanes:
        direct |= {a: {b} for a, b in zip(lane.keys, lane.keys[1:], strict=False)}
        direct[lane.keys[-1]] = {network.lanes[n].keys[0] for n in lane.successors}

    def resolve(key: Key, seen: set[Key]) -> set[Key]:
        out: set[Key] = set()
        for target in direct.get(key, set()) - seen:
            out |= {target} if target in known else resolve(target, seen | {target})
        return out

    return {key: resolve(key, {key}) for key in direct if key in known}


@pytest.mark.skipif(not FILES, reason="set ME3BEV_CARLA_PYTHON and ME3BEV_XODR_DIR to compare with carla.Map")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_lanes_are_where_carla_has_them(path: Path, tmp_path: Path) -> None:
    answer = asked(path, tmp_path)
    document = read_document(path, path.name)
    network = build_network(document, section_shapes(document))
    town = read_town(path, path.name)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(town.lanes, network.lanes, strict=True))

    keys: list[Key] = [(str(road), int(section), int(lane)) for road, section, lane in answer["keys"]]
    rows = answer["points"][:, 3].astype(int)
    plane, height = [], []
    for row, key in enumerate(keys):
        if key in network.of:
            away, above = apart(answer["points"][rows == row, :3], network.lanes[network.of[key]].points)
            plane.append(away)
            height.append(above)
    found = [key for key in keys if key in network.of]
    assert len(found) >= 0.99 * len(keys)  # A lane that leads nowhere is not driven.
    assert np.percentile(np.concatenate(plane), 99) < NEAR
    assert np.percentile(np.concatenate(height), 99) < NEAR

    theirs: dict[Key, set[Key]] = {key: set() for key in keys}
    for a, b in answer["links"]:
        theirs[keys[a]].add(keys[b])
    ours = followers(network, set(keys))
    reached = {target for targets in theirs.values() for target in targets}
    for key in found:
        assert theirs[key] & set(found) <= ours[key], key
        # A lane that opens within a road has no predecessor in the file; ours branches off the one beside it.
        assert not {target for target in ours[key] - theirs[key] if target in reached and theirs[key]}, key
