"""Every OpenDRIVE file of a folder that the user names: `ME3BEV_XODR_DIR=/maps pytest tests/simulator/opendrive`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from simulator.town_checks import check_town

from me3bev_plugins.simulator.highway.opendrive import read_town

FOLDER = os.environ.get("ME3BEV_XODR_DIR")
FILES = sorted(path for path in Path(FOLDER).iterdir() if path.name.endswith((".xodr", ".xodr.gz"))) if FOLDER else []
ROUGHEST = 6.0
"""Degrees at a joint: exported files hold a few short connectors that begin aslant."""


@pytest.mark.skipif(not FILES, reason="set ME3BEV_XODR_DIR to a folder of .xodr files to read them all")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_given_town_is_sound(path: Path) -> None:
    town = read_town(path, path.name)
    check_town(town, joint_kink=ROUGHEST)
    assert town.surfaces
    assert town.props
