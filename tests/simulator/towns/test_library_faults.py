"""Imports that fail: a full disk, odd files, files that are too large; nothing is left behind."""

from __future__ import annotations

import errno
import os
import zlib
from pathlib import Path

import pytest
from simulator.opendrive_text import RoadText, document, stadium

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway import Highway
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.opendrive import source as opendrive_source


def kept(data: Path) -> list[str]:
    return sorted(path.name for path in data.rglob("*") if path.is_file())


@pytest.mark.parametrize("call", ["write", "os.fsync", "os.replace", "tempfile.mkstemp", "mkdir"])
def test_a_full_disk_leaves_nothing_behind(
    world: Highway, data: Path, ring: Path, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    world.import_map(ring, "old", False)
    before = (data / "maps" / "old.xodr.gz").read_bytes()
    ring.write_bytes(stadium(radius=40.0))

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    class FullFile:
        def __init__(self, handle: int, mode: str) -> None:
            self.handle = handle

        def __enter__(self) -> FullFile:
            return self

        def __exit__(self, *_: object) -> None:
            os.close(self.handle)

        write = full

    with monkeypatch.context() as patch:
        if call == "write":
            patch.setattr("os.fdopen", FullFile)
        elif call == "mkdir":
            patch.setattr(Path, "mkdir", full)
        else:
            patch.setattr(call, full)
        for name in ("new", "old"):
            with pytest.raises(MapError, match=r"cannot be written: No space left on device. Nothing was kept"):
                world.import_map(ring, name, True)
    assert kept(data) == ["old.xodr.gz"]
    assert (data / "maps" / "old.xodr.gz").read_bytes() == before


def test_a_file_where_the_folder_should_be(world: Highway, data: Path, ring: Path) -> None:
    data.write_text("not a folder")
    assert world.maps() == MAPS
    for use in (world.map_entries, lambda: world.import_map(ring, None, False), lambda: world.remove_map("x")):
        with pytest.raises(MapError, match="data"):
            use()
    assert load_town("T2").name == "T2"


def test_odd_sources_are_map_errors(world: Highway, data: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.xodr")
    for path, message in (
        (tmp_path / "none.xodr", "cannot be read .No such file"),
        (tmp_path, "cannot be read .is a folder"),
        (tmp_path / "pipe.xodr", "is no ordinary file"),
        (Path("/dev/zero"), "is no ordinary file"),
        (tmp_path / "a\0b.xodr", "null"),
    ):
        with pytest.raises(MapError, match=message):
            world.import_map(path, "odd", False)
    assert kept(data) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_an_unreadable_file_is_named(world: Highway, ring: Path) -> None:
    ring.chmod(0)
    with pytest.raises(MapError, match=r"Ring.xodr: cannot be read \(Permission denied\)"):
        world.import_map(ring, None, False)


def test_a_refusal_to_open_is_a_map_error(world: Highway, ring: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(MapError, match=r"Ring.xodr: cannot be read \(Permission denied\)"):
        world.import_map(ring, None, False)


def test_what_is_too_large_is_refused_before_it_fills_memory(
    world: Highway, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    squeeze = zlib.compressobj(9, zlib.DEFLATED, 31)
    bomb = tmp_path / "bomb.xodr.gz"
    blank = b" " * 2**20
    bomb.write_bytes(b"".join(squeeze.compress(blank) for _ in range(300)) + squeeze.flush())
    assert bomb.stat().st_size < 2**20
    with pytest.raises(MapError, match="more than 256 MiB of XML"):
        world.import_map(bomb, None, False)
    monkeypatch.setattr(opendrive_source, "LARGEST", 1000)
    plain = tmp_path / "plain.xodr"
    plain.write_bytes(stadium())
    with pytest.raises(MapError, match="more than 0 MiB of XML"):
        world.import_map(plain, None, False)
    assert kept(data) == []


def test_entities_that_blow_up_and_deep_files_are_refused(world: Highway, tmp_path: Path) -> None:
    lines = ['<!ENTITY a "aaaaaaaaaa">']
    lines += [f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(11)]
    path = tmp_path / "laughs.xodr"
    path.write_text(f"<!DOCTYPE x [{''.join(lines)}]><OpenDRIVE>&l;</OpenDRIVE>")
    with pytest.raises(MapError, match="not well-formed XML"):
        world.import_map(path, None, False)
    path.write_text(f"<OpenDRIVE>{'<lane>' * 200_000}{'</lane>' * 200_000}</OpenDRIVE>")
    with pytest.raises(MapError, match="has no <road>"):
        world.import_map(path, None, False)


def test_a_town_too_slow_to_drive_is_refused(world: Highway, tmp_path: Path) -> None:
    path = tmp_path / "slow.xodr"
    path.write_bytes(stadium().replace(b'max="50"', b'max="0.5"'))
    with pytest.raises(MapError, match=r"slow.xodr: the longest route found is 0\.9 m"):
        world.import_map(path, None, False)


def test_a_document_without_a_course_says_so(world: Highway, tmp_path: Path) -> None:
    path = tmp_path / "line.xodr"
    path.write_bytes(document(RoadText("1", '<geometry s="0" x="0" y="0" hdg="0" length="50"><line/></geometry>', 50)))
    with pytest.raises(MapError, match=r"line.xodr: no driving lane leads back to where it began"):
        world.import_map(path, None, False)
