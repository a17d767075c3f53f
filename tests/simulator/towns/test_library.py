"""Imported towns: where they are kept, under which names, and that they are read again when they change."""

from __future__ import annotations

import gzip
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from simulator.opendrive_text import RoadText, stadium
from simulator.town_checks import check_town

from me3bev_cli.api import FactRow, MapEntry
from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway import Highway, library_store
from me3bev_plugins.simulator.highway.maps import MAPS, available, load_town


def kept(data: Path) -> list[str]:
    return sorted(path.name for path in data.rglob("*") if path.is_file())


def test_before_any_import_there_are_the_built_in_towns(world: Highway, data: Path) -> None:
    assert world.maps() == available() == MAPS
    assert [(entry.name, entry.source) for entry in world.map_entries()] == [(name, "built-in") for name in MAPS]
    assert all(entry.description for entry in world.map_entries())
    assert not data.exists()


def test_an_imported_town_is_there_from_then_on(world: Highway, data: Path, ring: Path) -> None:
    entry = world.import_map(ring, None, False)
    # The lane of the other direction is a course of its own.
    description = (
        "0.6 km of lanes, 0 junctions, 0 with traffic lights; 0.26 km left out: dead ends, or apart from the rest"
    )
    assert entry == MapEntry("Ring", "imported", description)
    assert kept(data) == ["Ring.xodr.gz"]
    assert gzip.decompress((data / "maps" / "Ring.xodr.gz").read_bytes()) == stadium()
    assert world.map_entries()[-1] == entry
    assert world.maps() == (*MAPS, "Ring")
    check_town(load_town("Ring"))
    assert load_town("Ring") is load_town("Ring")
    world.remove_map("Ring")
    assert world.maps() == MAPS
    with pytest.raises(MapError, match="unknown map 'Ring'"):
        load_town("Ring")


def test_an_evaluations_identity_knows_the_file_of_an_imported_town(world: Highway, data: Path, ring: Path) -> None:
    """Logs of a map that was replaced must not be taken for those of the new one."""
    from me3bev_cli.api import ObservationConfig
    from me3bev_cli.evaluation.drivers import DriverSpec
    from me3bev_cli.evaluation.identity import identity
    from me3bev_cli.evaluation.player import Method
    from me3bev_cli.evaluation.runner import World
    from me3bev_cli.recipe import PluginChoice

    world.import_map(ring, None, False)
    method = Method(DriverSpec("idle", "idle"), World(PluginChoice(name="highway"), ObservationConfig()))
    first = identity(method, 0, ["T1", "Ring"])
    assert list(first["maps"]) == ["Ring"]
    assert "maps" not in identity(method, 0, ["T1"])
    file = data / "maps" / "Ring.xodr.gz"
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    changed = identity(method, 0, ["T1", "Ring"])
    assert changed["maps"] != first["maps"]
    assert changed | {"maps": 0} == first | {"maps": 0}


def test_gymnasium_drives_an_imported_town(world: Highway, ring: Path) -> None:
    world.import_map(ring, "mine", False)
    env = gymnasium.make("me3bev/Town-v0", map="mine", images=False, vehicles=3, pedestrians=3)
    env.reset(seed=1)
    for _ in range(20):
        observation, *_ = env.step(env.unwrapped.autopilot())  # type: ignore[attr-defined]
    assert env.unwrapped._record["route_done"] > 1.0  # type: ignore[attr-defined]
    assert all(np.isfinite(value).all() for value in observation.values())


def test_a_compressed_file_is_imported_alike(world: Highway, data: Path, ring: Path, tmp_path: Path) -> None:
    packed = tmp_path / "Packed.xodr.gz"
    packed.write_bytes(gzip.compress(ring.read_bytes()))
    assert world.import_map(packed, None, False).name == "Packed"
    world.import_map(ring, "Packed2", False)
    first, second = ((data / "maps" / f"{name}.xodr.gz").read_bytes() for name in ("Packed", "Packed2"))
    assert first == second


def test_a_town_imported_again_is_read_again(world: Highway, ring: Path) -> None:
    world.import_map(ring, None, False)
    before = load_town("Ring")
    with pytest.raises(MapError, match=r"Ring.xodr: there is an imported map 'Ring' already. .*add --replace"):
        world.import_map(ring, None, False)
    assert load_town("Ring") is before
    ring.write_bytes(stadium(radius=40.0))
    world.import_map(ring, None, True)
    after = load_town("Ring")
    assert sum(lane.length for lane in after.lanes) > 1.1 * sum(lane.length for lane in before.lanes)


def test_dead_ends_are_left_out_and_said(world: Highway, tmp_path: Path) -> None:
    ring = stadium().decode()
    stub = RoadText(
        "stub", '<geometry s="0" x="0" y="300" hdg="0" length="120"><line/></geometry>', 120.0,
        right='<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>',
    )  # fmt: skip
    path = tmp_path / "stub.xodr"
    path.write_text(ring.replace("</OpenDRIVE>", f"{stub}</OpenDRIVE>"))
    entry = world.import_map(path, None, False)
    assert entry.description.endswith("; 0.38 km left out: dead ends, or apart from the rest")
    check_town(load_town("stub"))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("T3", "'T3' is a built-in map"),
        ("t3", "'T3' is a built-in map"),
        ("ring", "'ring' differs from the imported map 'Ring' in case only"),
        ("All", "'all' is a word of its own"),
        ("3rd", "'3rd' cannot be the name of a map"),
        ("a b", "cannot be the name of a map. Allowed: a letter, then"),
        ("../up", "cannot be the name of a map"),
        ("a/b", "cannot be the name of a map"),
        ("Städte", "cannot be the name of a map"),
        ("", "'' cannot be the name of a map"),
        ("x" * 65, "cannot be the name of a map"),
        ("a\n", "cannot be the name of a map"),
    ],
)
def test_a_name_that_cannot_be_used(world: Highway, data: Path, ring: Path, name: str, message: str) -> None:
    world.import_map(ring, None, False)
    with pytest.raises(MapError) as caught:
        world.import_map(ring, name, True)
    assert str(caught.value).startswith("--name: ")
    assert message in str(caught.value)
    assert "--name" in (caught.value.hint or "")
    assert kept(data) == ["Ring.xodr.gz"]


def test_maps_are_listed_in_the_order_of_their_numbers(world: Highway, ring: Path) -> None:
    for name in ("b10", "a", "b9"):
        world.import_map(ring, name, False)
    assert world.maps() == (*MAPS, "a", "b9", "b10")


def test_what_is_no_imported_town_is_not_listed(world: Highway, data: Path, ring: Path) -> None:
    world.import_map(ring, None, False)
    folder = data / "maps"
    for name in ("T1.xodr.gz", ".Ring.xodr.gz.abc", "notes.txt", "a b.xodr.gz"):
        (folder / name).write_bytes(b"")
    (folder / "sub.xodr.gz").mkdir()
    assert world.maps() == (*MAPS, "Ring")


def test_a_town_put_there_by_hand_can_be_driven(world: Highway, data: Path) -> None:
    folder = data / "maps"
    folder.mkdir(parents=True)
    (folder / "hand.xodr.gz").write_bytes(gzip.compress(stadium()))
    assert world.map_entries()[-1] == MapEntry("hand", "imported", "")
    check_town(load_town("hand"))
    (folder / "hand.xodr.gz").write_bytes(b"\x1f\x8b\x08\x10broken")
    with pytest.raises(MapError, match=r"hand.xodr.gz: the compressed file is damaged"):
        load_town("hand")
    world.remove_map("hand")


@pytest.mark.parametrize("name", ["T1", "nothing"])
def test_what_cannot_be_removed(world: Highway, name: str) -> None:
    with pytest.raises(MapError, match=r"built-in map|none has been imported"):
        world.remove_map(name)


def test_removing_a_misspelt_town_suggests_one(world: Highway, ring: Path) -> None:
    world.import_map(ring, "Town03", False)
    with pytest.raises(MapError, match="unknown imported map 'Town30'; did you mean 'Town03'"):
        world.remove_map("Town30")


def test_facts_have_references_for_built_in_towns_only(world: Highway, ring: Path) -> None:
    world.import_map(ring, "Town02", False)
    measured, own = world.map_facts("T2"), world.map_facts("Town02")
    assert all(isinstance(row, FactRow) for row in (*measured, *own))
    assert any(row.within is not None for row in measured)
    assert {row.reference for row in own} == {None}
    with pytest.raises(MapError, match="unknown map 'T22'"):
        world.map_facts("T22")


def test_a_plan_is_a_picture_that_depends_on_the_seed(world: Highway) -> None:
    first, again, other = (world.map_plan("T2", seed) for seed in (1, 1, 2))
    assert first.dtype == np.uint8
    assert first.ndim == 3
    assert first.shape[2] == 3
    assert np.array_equal(first, again)
    assert first.shape != other.shape or not np.array_equal(first, other)


def test_without_the_variable_the_systems_own_folder_is_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("ME3BEV_DATA")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert library_store.folder().parts[-2:] == ("me3bev", "maps")
    monkeypatch.setenv("ME3BEV_DATA", "~/towns")
    assert library_store.folder() == Path.home() / "towns" / "maps"


def test_another_process_sees_the_town(world: Highway, ring: Path) -> None:
    world.import_map(ring, "shared", False)
    code = "from me3bev_plugins.simulator.highway.maps import load_town; print(load_town('shared').description)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == load_town("shared").description
