"""Two methods on the same seeds: differences and wins by hand, intervals against an independent bootstrap."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from episodes import episode

from me3bev_cli.errors import UserError
from me3bev_cli.evaluation.compare import Comparison, compare
from me3bev_cli.evaluation.definitions import METRICS
from me3bev_cli.evaluation.episode import Episode
from me3bev_cli.evaluation.summary import AVERAGE, score


def drives(driver: str, rewards: list[float], map: str = "T1", first: int = 0) -> list[Episode]:
    return [
        replace(episode(4, driver=driver, map=map, reward=reward), seed=first + number, index=number)
        for number, reward in enumerate(rewards)
    ]


def one(found: list[Comparison], metric: str = "return_per_step", map: str = "T1") -> Comparison:
    (comparison,) = [c for c in found if c.metric == metric and c.map == map]
    return comparison


def test_a_difference_by_hand() -> None:
    found = compare(score([*drives("new", [3, 5, 2, 9]), *drives("old", [1, 5, 4, 1])]), "old")
    c = one(found)
    # +2, 0, -2, +8; two wins and a tie of four.
    assert (c.method, c.baseline, c.difference, c.improvement, c.n) == ("new", "old", 2.0, 0.625, 4)
    assert c.low <= 2.0 <= c.high
    assert c.low < 0
    assert (c.significant, c.verdict) == (False, "")
    assert {c.metric for c in found} == set(METRICS)


def test_pairs_are_of_the_same_seed() -> None:
    # Of the three and the three only seeds 1 and 2 are shared: 5 - 10 and 2 - 20.
    found = compare(score([*drives("new", [3, 5, 2]), *drives("old", [10, 20, 30], first=1)]), "old")
    assert (one(found).difference, one(found).n) == (-11.5, 2)


def test_the_interval_is_that_of_paired_differences() -> None:
    rng = np.random.default_rng(0)
    seeds = rng.normal(0, 50, 80)
    new, old = (seeds + rng.normal(shift, 1, 80) for shift in (0.6, 0.0))
    c = one(compare(score([*drives("new", list(new)), *drives("old", list(old))]), "old"))
    half = 1.96 * (new - old).std() / math.sqrt(80)
    assert c.low == pytest.approx(c.difference - half, abs=0.1)
    assert c.high == pytest.approx(c.difference + half, abs=0.1)
    # Unpaired, the seeds' spread of 50 would have hidden it.
    assert (c.significant, c.verdict) == (True, "better")
    assert c.improvement == pytest.approx(float(np.mean(new > old)))
    assert c.improvement_low < c.improvement < c.improvement_high


def test_what_is_better_depends_on_the_metric() -> None:
    fast = [replace(e, driver="fast") for e in drives("x", [1] * 6)]
    crash = [
        replace(episode(5, "collision", driver="crash", collision=[""] * 4 + ["vehicle"], speed=9.0), seed=number)
        for number in range(6)
    ]
    found = compare(score([*fast, *crash]), "fast")
    rate = one(found, "collision_rate")
    assert (rate.difference, rate.improvement, rate.verdict) == (1.0, 0.0, "worse")
    steps = one(found, "timesteps")
    assert (steps.difference, steps.improvement, steps.verdict) == (1.0, 1.0, "better")
    speed = one(found, "mean_speed")
    assert (speed.difference, speed.verdict) == (4.0, "other")
    assert math.isnan(speed.improvement)
    # The same everywhere: no difference, and nothing to be said of it.
    same = one(found, "similarity")
    assert (same.difference, same.low, same.high, same.improvement, same.verdict) == (0, 0, 0, 0.5, "")


def test_maps_weigh_alike_and_nan_pairs_are_left_out() -> None:
    new = [*drives("new", [1, 1, 1, 1]), *drives("new", [5, 5], map="T2")]
    old = [*drives("old", [0, 0, 0, 0]), *drives("old", [0, 0], map="T2")]
    found = compare(score([*new, *old]), "old")
    assert (one(found, map=AVERAGE).difference, one(found, map=AVERAGE).n) == (3.0, 6)
    assert (one(found, "efficiency").n, one(found, "efficiency").significant) == (0, False)


def test_mistakes() -> None:
    both = score([*drives("new", [1, 2]), *drives("old", [1, 2], first=50)])
    with pytest.raises(UserError, match=r"--baseline: unknown baseline 'odl'; did you mean 'old'\?"):
        compare(both, "odl")
    with pytest.raises(UserError, match="'new' and 'old' share no episode of the same map, density and seed"):
        compare(both, "old")
