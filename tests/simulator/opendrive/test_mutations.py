"""Damaged files: each is a typed error that says what and where, or a town that can be driven; never a hang or crash.

`ME3BEV_XODR_DIR=/maps pytest tests/simulator/opendrive` damages every file of a folder too.
"""

from __future__ import annotations

import gzip
import os
import signal
from collections import Counter
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from simulator.mutations import KINDS, mutated
from simulator.opendrive_text import RoadText, document, stadium
from simulator.town_checks import check_town

from me3bev_cli.errors import MapError
from me3bev_plugins.simulator.highway import Highway, HighwayConfig
from me3bev_plugins.simulator.highway.env import TownEnv
from me3bev_plugins.simulator.highway.maps import load_town
from me3bev_plugins.simulator.highway.opendrive import read_town

COUNT = 10 * len(KINDS)
"""Mutations of the small town."""
ENOUGH = 120.0
"""Seconds of computing after which something hangs."""
ANY = 181.0
"""Degrees: a damaged line may kink."""

FOLDER = os.environ.get("ME3BEV_XODR_DIR")
GIVEN = sorted(path for path in Path(FOLDER).iterdir() if path.name.endswith((".xodr", ".xodr.gz"))) if FOLDER else []


@pytest.fixture(autouse=True)
def _no_hang() -> Iterator[None]:
    def hangs(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"still busy after {ENOUGH:.0f} s of computing")

    before = signal.signal(signal.SIGPROF, hangs)
    yield
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.signal(signal.SIGPROF, before)


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Highway:
    monkeypatch.setenv("ME3BEV_DATA", str(tmp_path / "data"))
    return Highway(HighwayConfig())


def shipped(name: str) -> bytes:
    return gzip.decompress((files("me3bev_plugins.simulator.highway.towns") / f"{name}.xodr.gz").read_bytes())


def outcome(world: Highway, text: bytes, path: Path, *, drive: bool) -> str:
    """ "town" or "error": what importing a damaged text comes to, checked."""
    path.write_bytes(text)
    signal.setitimer(signal.ITIMER_PROF, ENOUGH)
    refusal: MapError | None = None
    try:
        world.import_map(path, "damaged", True)
    except MapError as fault:
        refusal = fault
    if refusal is not None:
        assert str(refusal).startswith(f"{path}: ")
        assert refusal.hint or refusal.allowed
        return "error"
    town = load_town("damaged")
    check_town(town, joint_kink=ANY, kink=ANY)
    if drive:
        env = TownEnv(map=town, density="low", images=False)
        for seed in (0, 1):
            env.reset(seed=seed)
            for _ in range(10):
                observation, _, terminated, truncated, _ = env.step(env.autopilot())
                assert all(np.isfinite(value).all() for value in observation.values())
                if terminated or truncated:
                    break
    return "town"


def run_through(world: Highway, text: bytes, folder: Path, seeds: range, every: int) -> Counter[tuple[str, str]]:
    """How each mutation ended; of the towns every so many-th is driven."""
    ends: Counter[tuple[str, str]] = Counter()
    towns = 0
    for seed in seeds:
        kind, damaged = mutated(text, seed)
        try:
            end = outcome(world, damaged, folder / "damaged.xodr", drive=towns % every == 0)
        except Exception as defect:
            raise AssertionError(f"{kind}, seed {seed}: {type(defect).__name__}: {defect}") from defect
        towns += end == "town"
        ends[kind, end] += 1
    return ends


def test_a_small_town_damaged_in_many_ways(world: Highway, tmp_path: Path) -> None:
    ends = run_through(world, shipped("T2"), tmp_path, range(COUNT), every=12)
    assert sum(ends.values()) == COUNT >= 100
    assert {kind for kind, _ in ends} == {kind.__name__ for kind in KINDS}
    # Neither is everything refused, nor is nothing.
    assert sum(count for (_, end), count in ends.items() if end == "town") > COUNT / 4
    assert sum(count for (_, end), count in ends.items() if end == "error") > COUNT / 4
    assert ends["truncate", "town"] == 0


def test_country_roads_with_signs_damaged(world: Highway, tmp_path: Path) -> None:
    seeds = range(1000, 1000 + 2 * len(KINDS))
    ends = run_through(world, shipped("T7"), tmp_path, seeds, every=8)
    assert sum(ends.values()) == len(seeds)


@pytest.mark.skipif(not GIVEN, reason="set ME3BEV_XODR_DIR to a folder of .xodr files to damage them all")
@pytest.mark.parametrize("path", GIVEN, ids=lambda path: path.name)
def test_a_given_town_damaged(world: Highway, tmp_path: Path, path: Path) -> None:
    text = path.read_bytes()
    text = gzip.decompress(text) if path.name.endswith(".gz") else text
    first = path is GIVEN[0]
    seeds = range(2000, 2000 + (10 if first else 2) * len(KINDS))
    ends = run_through(world, text, tmp_path, seeds, every=40 if first else 10)
    assert sum(ends.values()) == len(seeds)


def test_mutations_are_the_same_each_time_and_real() -> None:
    text = shipped("T2")
    assert [mutated(text, seed) for seed in range(8)] == [mutated(text, seed) for seed in range(8)]
    assert all(mutated(text, seed)[1] != text for seed in range(8))


RING = stadium().decode()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (RING.replace('length="', 'length="-', 1), "road '1': length='-"),
        (
            RING.replace('y="-30.0"', 'y="-9e8"', 1),
            "road '1': <geometry> jumps",
        ),
        (RING.replace('a="3.5"', 'a="nan"', 1), "road '1': <width> a='nan' is out of range"),
        (RING.replace('a="3.5"', 'a="inf"', 1), "road '1': <width> a='inf' is out of range"),
        (RING.replace('a="3.5" b="0"', 'a="3.5" b="90"', 1), "m wide or more"),
        (RING.replace('<laneOffset s="0" a="0', '<laneOffset s="0" a="4000', 1), "m beside its road"),
        (
            RING.replace('<elevation s="0" a="0.0', '<elevation s="0" a="1e8', 1),
            "road '1': <elevation> reaches 1e+08 m",
        ),
        (RING.replace('max="50"', 'max="1e6"', 1), "road '1': <speed> max='1e6' is out of range"),
        (RING.replace('<road id="1"', "<road", 1), "road 'None': <road> has no 'id'"),
        (RING.replace('length="', 'width="', 1), "road '1': <road> has no 'length'"),
    ],
)
def test_what_is_out_of_bounds_is_named(text: str, message: str) -> None:
    assert text != RING
    with pytest.raises(MapError) as caught:
        read_town(text.encode(), "my.xodr")
    assert str(caught.value).startswith("my.xodr: road ")
    assert message in str(caught.value)
    assert "Check the file" in str(caught.value)


def _straight(name: str, x: float, length: float = 50.0, lanes: int = 1) -> RoadText:
    right = "".join(
        f'<lane id="{-n}" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane>'
        for n in range(1, lanes + 1)
    )
    plan = f'<geometry s="0" x="{x}" y="500" hdg="0" length="{length}"><line/></geometry>'
    return RoadText(name, plan, length, right=right)


@pytest.mark.parametrize(
    ("roads", "message"),
    [
        ([_straight("far", 50_000.0)], "road 'far': <geometry> lies 5.,... m from the middle of the town"),
        ([_straight("wide", 0.0, lanes=101)], "road 'wide': the section at s=0 has 102 lanes"),
        (
            [_straight(f"r{n}", 0.0, 90_000.0) for n in range(23)],
            "2,07.,... metres of road. Allowed: at most 2,000,000",
        ),
    ],
)
def test_what_is_larger_than_a_town_is_refused(roads: list[RoadText], message: str) -> None:
    text = stadium().decode().replace("</OpenDRIVE>", "".join(map(str, roads)) + "</OpenDRIVE>")
    with pytest.raises(MapError, match=message):
        read_town(text.encode(), "my.xodr")


def test_a_curve_that_asks_for_all_memory_is_refused() -> None:
    curve = "<arc curvature='99'/>"
    roads = [
        RoadText(
            str(n), f'<geometry s="0" x="0" y="0" hdg="0" length="60000">{curve}</geometry>', 60_000.0,
            right='<lane id="-1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane>',
        )
        for n in range(3)
    ]  # fmt: skip
    with pytest.raises(MapError, match=r"road '.': its curves need more samples than a whole town may have"):
        read_town(document(*roads), "my.xodr")


def test_a_road_that_follows_itself_is_a_course(world: Highway, tmp_path: Path) -> None:
    turn = '<geometry s="0" x="0" y="0" hdg="0" length="314.159265"><arc curvature="0.02"/></geometry>'
    itself = '<{0} elementType="road" elementId="1" contactPoint="{1}"/>'
    road = RoadText(
        "1", turn, 314.159265, before=itself.format("predecessor", "end"), after=itself.format("successor", "start"),
        right='<lane id="-1" type="driving"><link><predecessor id="-1"/><successor id="-1"/></link>'
        '<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>',
    )  # fmt: skip
    assert outcome(world, document(road), tmp_path / "circle.xodr", drive=True) == "town"
    assert load_town("damaged").lanes[0].successors == (0,)
