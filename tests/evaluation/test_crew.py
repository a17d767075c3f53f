"""A batch of several environments: what one row computes does not depend on the others."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from me3bev_cli.evaluation.crew import ROWS, Together, make_crew
from me3bev_cli.evaluation.drivers import DriverSpec
from me3bev_cli.pipeline.control import Controller
from me3bev_cli.recipe_loading import resolve_recipe

STEPS = 4
TINY = (
    "observation={height: 48, width: 128}", "spatial.bev_channels=[8, 8, 8]", "spatial.channels=4",
    "spatial.token_width=8", "spatial.cell=2.5",
)  # fmt: skip


CONTEXTS = {"window": "{kind: window, length: 3}", "stream": "{kind: stream}"}
MEMORIES = ("mamba", "gru", "lstm", "transformer")


@pytest.fixture(scope="module", params=itertools.product(CONTEXTS, MEMORIES), ids="-".join)
def crew(request: pytest.FixtureRequest) -> Together:
    context, memory = request.param
    recipe = resolve_recipe("small", [*TINY, f"context={CONTEXTS[context]}", f"temporal={{name: {memory}}}"])
    found = make_crew(DriverSpec("untrained", "untrained", recipe=recipe))
    assert isinstance(found, Together)
    return found


def observations(seed: int) -> list[dict[str, NDArray[Any]]]:
    rng = np.random.default_rng(seed)
    widths = {"road": 9, "vehicle": 4, "navigation": 5}
    return [
        {
            "images": rng.integers(0, 256, (6, 3, 48, 128), np.uint8),
            **{key: rng.normal(size=width).astype(np.float32) for key, width in widths.items()},
        }
        for _ in range(STEPS)
    ]


def drive(
    crew: Together, row: int, episode: list[Any], others: Mapping[int, list[Any]], before: int = 0, again: int = -1
) -> bytes:
    """The actions of an episode in a row, with others in other rows, which began some steps earlier, and once again."""
    for other in others:
        crew.begin(other, None, 0)
    for step in range(before):
        crew.act({other: seen[step % STEPS] for other, seen in others.items()}, {})
    crew.begin(row, None, 0)
    actions = []
    for step in range(STEPS):
        if step == again:
            for other in others:
                crew.begin(other, None, 0)
        seen = {other: seen[(before + step) % STEPS] for other, seen in others.items()}
        actions.append(crew.act({**seen, row: episode[step]}, {})[row])
    return np.stack(actions).tobytes()


@pytest.mark.parametrize("row", [0, ROWS - 1])
def test_company_changes_no_bit(crew: Together, row: int) -> None:
    mine = observations(0)
    rest = [other for other in range(ROWS) if other != row]
    alone = drive(crew, row, mine, {})
    assert drive(crew, row, mine, {other: observations(10 + other) for other in rest}) == alone
    assert drive(crew, row, mine, {rest[0]: observations(20)}, before=2) == alone
    assert drive(crew, row, mine, {rest[1]: observations(21)}, before=1, again=2) == alone
    assert drive(crew, row, observations(1), {}) != alone


def test_a_row_drives_as_the_policy_does(crew: Together) -> None:
    controller = Controller(crew.network, resolve_recipe("small"))
    mine = observations(3)
    found = np.frombuffer(drive(crew, 1, mine, {0: observations(4)}), np.float32).reshape(STEPS, 2)
    # Another number of rows adds in another order: equal but for the last digits.
    np.testing.assert_allclose(found, [controller.act(seen) for seen in mine], atol=1e-5)
