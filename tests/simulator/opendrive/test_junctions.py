"""Three streets that meet: connectors, control, signals, signs, limits, crosswalks."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from simulator.opendrive_text import WIDTH, tee
from simulator.town_checks import check_town

from me3bev_plugins.simulator.highway.opendrive import read_town
from me3bev_plugins.simulator.highway.town import Junction, Lane, Town

END = 'id="{}" s="{}" t="{}" orientation="+" type="{}" value="{}" unit="km/h"'


def signal(number: int, s: float, t: float, kind: str, value: float = -1, lanes: str = "", tag: str = "signal") -> str:
    """A <signal> or <signalReference>; `lanes` is a lane number for its validity."""
    validity = f'<validity fromLane="{lanes}" toLane="{lanes}"/>' if lanes else ""
    return f"<{tag} {END.format(number, s, t, kind, value)}>{validity}</{tag}>"


def approaches(town: Town) -> dict[str, Lane]:
    """The incoming lanes by where they come from."""
    names = {0: "west", 180: "east", 90: "south"}
    return {
        names[round(np.degrees(town.lanes[n].heading[-1])) % 360]: town.lanes[n] for n in town.junctions[0].incoming
    }


def read(**changes: dict[str, object]) -> tuple[Town, Junction]:
    town = read_town(tee(**changes), "tee")  # type: ignore[arg-type]
    check_town(town, joint_kink=8.0)  # Its far ends turn on a radius of 1.75 m: half a step either side.
    assert len(town.junctions) == 1
    return town, town.junctions[0]


def test_a_tee_has_three_arms_and_six_ways_through() -> None:
    town, junction = read()
    assert (junction.arms, len(junction.connectors), len(junction.incoming), len(junction.outgoing)) == (3, 6, 3, 3)
    turns = sorted(town.lanes[n].turn for n in junction.connectors)
    assert turns == ["left", "left", "right", "right", "straight", "straight"]
    assert junction.control == "none"
    for lane in approaches(town).values():
        assert len(lane.successors) == 2


def test_a_street_and_its_turning_loop_are_one_lane() -> None:
    town, junction = read()
    # 80 m out, half a circle of 1.75 m, 80 m back.
    for n in junction.incoming:
        assert town.lanes[n].length == pytest.approx(160 + pi * WIDTH / 2, abs=0.01)
        assert n in junction.outgoing


def test_connectors_take_the_limit_of_the_lane_before() -> None:
    fast = '<type s="0" type="town"><speed max="20" unit="m/s"/></type>'
    town, junction = read(r1={"speed": fast}, r19={"speed": fast})
    for n in junction.connectors:
        before = town.lanes[town.lanes[n].predecessors[0]]
        assert town.lanes[n].limit == before.limit
    assert approaches(town)["west"].limit == 20
    assert approaches(town)["east"].limit == pytest.approx(50 / 3.6)


@pytest.mark.parametrize("where", ["incoming road", "reference on the connectors"])
def test_lights_make_a_signal_for_every_approach(where: str) -> None:
    if where == "incoming road":
        town, junction = read(r3={"signals": signal(5, 79, -4, "1000001", lanes="-1")})
    else:
        stands = signal(5, 79, -4, "1000001")
        reference = signal(5, 0.5, 0, "", lanes="-1", tag="signalReference")
        town, junction = read(r3={"signals": stands}, r301={"signals": reference}, r302={"signals": reference})
    assert junction.control == "signal"
    assert junction.minor == frozenset()
    groups = {name: s.group for name, lane in approaches(town).items() for s in town.signals if lane.id in s.lanes}
    assert groups["west"] == groups["east"] != groups["south"]


def test_heads_hang_beyond_the_junction_on_the_right() -> None:
    town, _ = read(r3={"signals": signal(5, 79, -4, "1000001")})
    for head in town.signals:
        end = town.lanes[head.lanes[0]].points[-1]
        gap = np.array(head.position) - end
        ahead = gap[0] * np.cos(head.heading) + gap[1] * np.sin(head.heading)
        left = -gap[0] * np.sin(head.heading) + gap[1] * np.cos(head.heading)
        assert 12 <= ahead <= 20
        assert left == pytest.approx(-(WIDTH / 2 + 1))
        assert gap[2] == pytest.approx(5)


@pytest.mark.parametrize(("kind", "control"), [("206", "stop"), ("205", "yield")])
def test_signs_make_their_lane_give_way(kind: str, control: str) -> None:
    town, junction = read(r3={"signals": signal(5, 78, -4, kind)})
    south = approaches(town)["south"]
    assert junction.control == control
    assert junction.minor == {south.id}
    (sign,) = town.signs
    assert (sign.kind, sign.lane) == (control, south.id)
    assert sign.position[0] == pytest.approx(south.points[-1, 0] + WIDTH / 2 + 1.2)
    assert sign.heading == pytest.approx(pi / 2)


def test_a_light_outranks_a_sign() -> None:
    both = signal(5, 78, -4, "206") + signal(6, 79, -4, "1000001")
    town, junction = read(r3={"signals": both})
    assert (junction.control, junction.minor, town.signs) == ("signal", frozenset(), ())


@pytest.mark.parametrize(("far", "near", "most"), [(70, 50, 90), (20, 20, 30)])
def test_a_lane_has_the_limit_that_holds_along_most_of_it(far: float, near: float, most: float) -> None:
    """30 km/h on the way in from the west, 90 on the way out; nothing else is posted, so 30 spreads to all others."""
    town, _ = read(r1={"signals": signal(5, near, -4, "274", 30) + signal(6, far, 4, "274", 90)})
    west = approaches(town)["west"]
    # The lane of 165.5 m leads out of the junction and back in: 90 holds from its 10th (60th) metre to its 135th
    # (105th), and 30 along the rest.
    assert west.limit == pytest.approx(most / 3.6)
    assert all(town.lanes[n].limit == pytest.approx(30 / 3.6) for n in west.successors)
    assert approaches(town)["south"].limit == pytest.approx(30 / 3.6)


def test_where_ways_meet_each_limit_counts_as_much_and_the_lower_wins() -> None:
    signs = {"r1": {"signals": signal(5, 70, -4, "274", 60)}, "r2": {"signals": signal(6, 70, -4, "274", 40)}}
    town, _ = read(**signs)
    # Half of those who come into the south do so at 60, half at 40.
    assert approaches(town)["south"].limit == pytest.approx(40 / 3.6)
    # Into the west they come from the east at 40, and from the south at either: three quarters 40.
    west = approaches(town)["west"]
    assert west.limit == pytest.approx(40 / 3.6)
    assert all(town.lanes[n].limit == pytest.approx(60 / 3.6) for n in west.successors)


def test_a_single_sign_reaches_everything_that_follows() -> None:
    town, junction = read(r3={"signals": signal(5, 70, -4, "274", 20)})
    assert {round(town.lanes[n].limit * 3.6) for n in junction.incoming} == {20}


def test_signs_named_as_objects_count_as_posted() -> None:
    town, _ = read(r3={"objects": '<object id="1" type="-1" name="Speed_60" s="40" t="4"/>'})
    assert approaches(town)["south"].limit == pytest.approx(60 / 3.6)


OUTLINE = (
    '<object id="1" type="crosswalk" s="70" t="0" hdg="0"><outline>'
    '<cornerLocal u="-1.5" v="-3.5"/><cornerLocal u="1.5" v="-3.5"/>'
    '<cornerLocal u="1.5" v="3.5"/><cornerLocal u="-1.5" v="3.5"/><cornerLocal u="-1.5" v="-3.5"/>'
    "</outline></object>"
)


def test_crosswalks_know_the_lanes_they_cross_and_where() -> None:
    town, _ = read(r3={"objects": OUTLINE})
    (crosswalk,) = town.crosswalks
    south = approaches(town)["south"]
    # Street 3 runs north from y = -92 and ends at y = -12; its 70th metre is y = -22, the outline 1.5 m either way.
    assert crosswalk.junction == 0
    ((lane, s),) = crosswalk.lanes
    assert lane == south.id
    assert s == pytest.approx(8.5)  # Out of the junction first, at y = -20.5.
    np.testing.assert_allclose(np.sort(crosswalk.corners[:, 1]), [-23.5, -23.5, -20.5, -20.5], atol=1e-9)
    start, end = crosswalk.corners[:2].mean(0), crosswalk.corners[2:].mean(0)
    assert abs(end - start) == pytest.approx([7, 0], abs=1e-9)


def test_a_crosswalk_under_a_bridge_does_not_cross_what_is_above() -> None:
    low = OUTLINE.replace('t="0"', 't="0" zOffset="-5"')
    town, _ = read(r3={"objects": low})
    assert town.crosswalks == ()


def test_signalised_streets_with_sidewalks_get_crosswalks() -> None:
    town, _ = read(sides="sidewalk", r3={"signals": signal(5, 79, -4, "1000001")})  # type: ignore[arg-type]
    assert len(town.crosswalks) == 3
    for crosswalk in town.crosswalks:
        start, end = crosswalk.corners[:2].mean(0), crosswalk.corners[2:].mean(0)
        assert np.hypot(*(end - start)) == pytest.approx(2 * WIDTH + 1.2)
        crossed = [town.lanes[n] for n, _ in crosswalk.lanes]
        assert all(lane.junction == 0 for lane in crossed)
        assert len(crossed) >= 4
    assert read(r3={"signals": signal(5, 79, -4, "1000001")})[0].crosswalks == ()
