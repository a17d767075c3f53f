"""Every OpenDRIVE file of a folder that the user names: `ME3BEV_XODR_DIR=/maps pytest tests/simulator/opendrive`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from simulator.town_checks import check_town

from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.towns.facts import measure
from me3bev_plugins.simulator.highway.towns.facts_compare import compare
from me3bev_plugins.simulator.highway.towns.reference import REFERENCES

FOLDER = os.environ.get("ME3BEV_XODR_DIR")
FILES = sorted(path for path in Path(FOLDER).iterdir() if path.name.endswith((".xodr", ".xodr.gz"))) if FOLDER else []
MODELS = [path for path in FILES if path.name.replace("Town0", "T").removesuffix(".xodr") in REFERENCES]
"""Town01 to Town07, of which the reference figures are."""
ROUGHEST = 6.0
"""Degrees at a joint: exported files hold a few short connectors that begin aslant."""


@pytest.mark.skipif(not FILES, reason="set ME3BEV_XODR_DIR to a folder of .xodr files to read them all")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_given_town_is_sound(path: Path) -> None:
    town = read_town(path, path.name)
    check_town(town, joint_kink=ROUGHEST)
    assert town.surfaces
    assert town.props


@pytest.mark.skipif(not MODELS, reason="set ME3BEV_XODR_DIR to a folder with Town01.xodr to Town07.xodr")
@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.name)
def test_the_models_of_the_built_in_towns_measure_as_their_references_say(path: Path) -> None:
    name = path.name.replace("Town0", "T").removesuffix(".xodr")
    rows = compare(name, measure(read_town(path, name)))
    # The reference counts the approaches of T3's roundabout with it; here they are junctions of their own.
    known = {"2-arm junctions"} if name == "T3" else set()
    assert {row.key for row in rows if row.within is False} == known
    exact = [row for row in rows if "arm" in row.key or row.key in ("merges", "roundabouts")]
    assert {row.key for row in exact if row.value != row.reference} == known
    for row in rows:
        if row.key.startswith("lanes per direction"):
            assert row.value == pytest.approx(row.reference, abs=1.0)
