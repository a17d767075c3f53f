"""The rush-hour module. `ME3BEV_STRESS_MINUTES=10 pytest tests/simulator/traffic/test_stress.py` runs it in full."""

from __future__ import annotations

import os

import pytest
from simulator.tiny_town import build_tiny_town

from me3bev_plugins.simulator.highway import traffic_stress
from me3bev_plugins.simulator.highway.maps import MAPS, load_town
from me3bev_plugins.simulator.highway.scene import Kind

MINUTES = float(os.environ.get("ME3BEV_STRESS_MINUTES", "0"))


def test_it_reports_what_the_traffic_came_to() -> None:
    run = traffic_stress.stress(build_tiny_town(), 40.0, seed=2, vehicles=20, pedestrians=30)
    assert (run.vehicles, run.pedestrians) == (20, 30)
    assert sum(run.kinds.values()) == 20
    assert run.overlaps == run.hit == 0
    assert 0.5 < run.speed < 11.0
    assert 0.0 < max(run.longest_stand, run.longest_queue) <= 40.0


def test_it_prints_a_row_per_town(capsys: pytest.CaptureFixture[str]) -> None:
    code = traffic_stress.main(["--minutes", "0.1", "--maps", "T2", "T7", "--seeds", "2"])
    out = capsys.readouterr().out.splitlines()
    assert code == 0
    assert [line.split()[:2] for line in out[1:]] == [["T2", "0"], ["T2", "1"], ["T7", "0"], ["T7", "1"]]
    assert "truck" in out[1]


@pytest.mark.parametrize("name", MAPS)
def test_every_kind_of_vehicle_is_in_every_town(name: str) -> None:
    run = traffic_stress.stress(load_town(name), 1.0)
    assert run.vehicles == 100
    assert all(run.kinds[kind.name.lower()] > 0 for kind in Kind if kind != Kind.PEDESTRIAN)


@pytest.mark.skipif(not MINUTES, reason="set ME3BEV_STRESS_MINUTES, as to 10")
def test_rush_hour_in_full() -> None:
    assert traffic_stress.main(["--minutes", str(MINUTES)]) == 0
