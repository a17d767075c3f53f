"""Episodes are chosen by who is ahead in them: hand-worked encounters, and the town's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from me3bev_cli.api import Actors, ObservationConfig
from me3bev_cli.errors import UserError
from me3bev_cli.recipe_loading import resolve_recipe
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.environments import make_environments
from me3bev_cli.training.episodes import EpisodeMaker
from me3bev_cli.training.scouting import Scout
from me3bev_plugins.simulator.highway.simulator import Highway, HighwayConfig


class Drive(gymnasium.Env[Any, Any]):
    """An ego that drives north for ten steps; the seed says where the other one is, and how fast the ego is."""

    observation_space = spaces.Box(0, 1, (1,))
    action_space = spaces.Box(-1, 1, (2,))
    OTHERS: dict[int, tuple[float, float, float]] = {
        1: (0.0, 15.5, 5.0),  # right ahead until it is passed
        2: (3.0, 15.5, 5.0),  # in the next lane
        3: (0.0, 15.5, 1.0),  # right ahead of one that crawls
        4: (0.0, -3.0, 5.0),  # behind
        5: (1.4, 24.5, 5.0),  # ahead from the moment when it is within reach
        6: (-1.4, 24.5, 5.0),
    }

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        self.resets = [*getattr(self, "resets", []), seed]
        self.side, self.north, self.speed = self.OTHERS[seed or 0]
        self.y = 0.0
        return np.zeros(1), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert np.array_equal(action, np.array([0.5, 0.25], np.float32))
        self.y += 2.0
        return np.zeros(1), 0.0, self.y >= 20.0, False, {"record": {"speed": self.speed}}

    def autopilot(self) -> Any:
        return (0.5, 0.25)

    def pose(self) -> tuple[float, float, float]:
        return 0.0, self.y, np.pi / 2

    def actors(self) -> Actors:
        boxes = np.array([[self.side, self.north, 0.0, 0.0, 4.0, 2.0, 1.5]])
        return Actors(boxes, np.zeros(1, np.int64), np.zeros(1))


@pytest.mark.parametrize(("seed", "steps"), [(1, 7), (2, 0), (3, 0), (4, 0), (5, 8), (6, 8)])
def test_encounters_are_steps_with_somebody_right_ahead_of_a_moving_ego(seed: int, steps: int) -> None:
    """y = 2, 4 .. 20. One at 15.5 is ahead at 2 .. 14: seven; one at 24.5 comes within 20 m at 6: 6 .. 20, eight."""
    assert Scout(Drive, 2).encounters(seed) == steps


def test_the_busiest_is_taken_the_first_of_equals() -> None:
    made: list[Drive] = []

    def make() -> Drive:
        made.append(Drive())
        return made[-1]

    scout = Scout(make, 4)
    assert not made, "an environment that is not needed was made"
    assert scout.busiest([2, 1, 6, 5]) == 6
    assert scout.busiest([1, 5]) == 5
    assert len(made) == 1
    assert made[0].resets == [2, 1, 6, 5, 1, 5]
    scout.close()


def test_who_does_not_tell_where_others_are_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(Drive, "actors")
    with pytest.raises(UserError, match="no actors") as caught:
        Scout(Drive, 2).busiest([1, 2])
    assert "busiest_of" in str(caught.value)


def test_a_stage_s_episodes_are_those_chosen_of_their_index_with_any_workers(line_recipe: Path) -> None:
    """In the fake world nobody is in the way, so that the first of each index's seeds is taken."""
    recipe = resolve_recipe(line_recipe, ["stages.0.busiest_of=3", "stages.0.envs=2", "stages.0.workers=1"])
    stage = recipe.stages[0]
    seeds = []
    for workers in (1, 2):
        env = make_environments(recipe, stage.model_copy(update={"workers": workers}), 6)
        env.reset()
        seeds.append(env.get_attr("seed_used"))
        env.close()
    assert seeds[0] == seeds[1] == [derive_seed(recipe.seed, "F1", "low", index, 0) for index in (6, 7)]


def test_in_a_town_it_is_the_episode_with_most_encounters_and_nothing_is_drawn() -> None:
    simulator = Highway(HighwayConfig(vehicles=200, horizon=40))
    view = ObservationConfig(height=16, width=44)
    make = EpisodeMaker(simulator, view, "T2", "low", None, True, run_seed=4, first=2, stride=3, busiest_of=4)
    env = make()
    env.reset()
    scout = env.get_wrapper_attr("scout")
    assert "images" not in scout._env.observation_space.spaces
    counts = {seed: scout.encounters(seed) for seed in (derive_seed(4, "T2", "low", 2, one) for one in range(4))}
    assert counts[env.unwrapped.np_random_seed] == max(counts.values()) > min(counts.values())
    env.close()
