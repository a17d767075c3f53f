"""Damaged and wrong files: always a `MapError` that says what, where and what to do."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
from simulator.opendrive_text import stadium, tee

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway.opendrive import read_town

RING = stadium().decode()
WRONG = {
    "empty": ("", "my.xodr: the file is empty"),
    "blank": (" \n", "my.xodr: the file is empty"),
    "not XML": ("hello", "my.xodr: is not well-formed XML"),
    "another XML": ("<html/>", "the outermost element is <html>. Allowed: <OpenDRIVE>"),
    "no roads": ("<OpenDRIVE/>", "the file has no <road>"),
    "no plan": (RING.replace("planView", "plan"), "road '1': has no <planView> with a <geometry>"),
    "unknown curve": (RING.replace("<arc ", "<helix "), "road '1': <geometry> holds helix, not one of line, arc"),
    "no number": (RING.replace('x="-20.0"', 'x="left"'), "road '1': <geometry> x='left' is not a number"),
    "not finite": (RING.replace('x="-20.0"', 'x="nan"'), "road '1': <geometry> x='nan' is out of range"),
    "missing": (RING.replace('x="-20.0"', ""), "road '1': <geometry> has no 'x'"),
    "too sharp": (RING.replace('curvature="0.0', 'curvature="5000.0'), "road '1': <arc> curvature="),
    "too long": (RING.replace('<road id="1" length="', '<road id="1" length="99999'), "road '1': length="),
    "no sections": (RING.replace("laneSection", "section"), "road '1': has no <laneSection>"),
    "lane number": (
        RING.replace('<lane id="-1"', '<lane id="-1.5"'),
        "road '1': <lane> id='-1.5' is not a whole number",
    ),
    "same id": (RING.replace('<road id="2"', '<road id="1"'), "two roads have the id '1'"),
    "unit": (RING.replace("km/h", "knots"), "road '1': <speed> unit='knots' is not one of mph, km/h"),
    "left-hand": (RING.replace('<road id="1"', '<road rule="LHT" id="1"'), "road '1': traffic drives on the left"),
    "contact": (RING.replace('contactPoint="end"', 'contactPoint="middle"'), "contactPoint='middle' is neither"),
    "link": (RING.replace('elementType="road"', 'elementType="path"'), "elementType='path' is neither"),
    "dead end": (
        RING.replace(
            '<successor elementType="road" elementId="1"', '<successor elementType="road" elementId="9"'
        ).replace('<predecessor elementType="road" elementId="2"', '<predecessor elementType="road" elementId="9"'),
        "no driving lane leads back to where it began",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_named_with_its_fault(name: str) -> None:
    text, message = WRONG[name]
    with pytest.raises(MapError) as caught:
        read_town(text.encode(), "my.xodr")
    assert message in str(caught.value)
    assert str(caught.value).startswith("my.xodr: ")
    assert caught.value.hint or caught.value.allowed


@pytest.mark.parametrize("share", [i / 23 for i in range(23)])
def test_a_truncated_file_is_a_map_error(share: float) -> None:
    whole = tee()
    with pytest.raises(MapError):
        read_town(whole[: int(share * len(whole))], "cut")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"nowhere\.xodr: cannot be read \(No such file"):
        read_town(tmp_path / "nowhere.xodr", "nowhere")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="cannot be read"):
        read_town(tmp_path, "folder")


def test_compressed_files_read_alike_and_damaged_ones_are_named(tmp_path: Path) -> None:
    packed = gzip.compress(stadium())
    path = tmp_path / "ring.xodr.gz"
    path.write_bytes(packed)
    town = read_town(path, "ring")
    assert len(town.lanes) == len(read_town(stadium(), "ring").lanes)
    path.write_bytes(packed[:-20])
    with pytest.raises(MapError, match=r"ring\.xodr\.gz: the compressed file is damaged"):
        read_town(path, "ring")


def test_a_namespace_does_not_matter() -> None:
    text = stadium().replace(b"<OpenDRIVE>", b'<OpenDRIVE xmlns="http://www.opendrive.org">')
    assert len(read_town(text, "ring").lanes) == 4
