"""Rollout storage: what goes in comes out, as segments with their prefix."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces

from me3bev_cli.pipeline.policy import ROWS, STARTS, STATE
from me3bev_cli.training.rollout import SequenceRolloutBuffer, stored_arrays

STEPS, ENVS, SEGMENT, PREFIX = 8, 2, 4, 3


def placed(batch: Any) -> torch.Tensor:
    """(B, P + L): the frames of the segments where they stand."""
    return batch.observations["road"].ravel()[batch.observations[ROWS]]


def buffer(prefix: int = PREFIX) -> SequenceRolloutBuffer:
    space = spaces.Dict({"road": spaces.Box(-1e3, 1e3, (1,), np.float32), "images": spaces.Box(0, 255, (1,), np.uint8)})
    return SequenceRolloutBuffer(
        STEPS, space, spaces.Box(-1, 1, (2,), np.float32), "cpu", n_envs=ENVS, segment=SEGMENT, prefix=prefix, seed=0
    )


def fill(store: SequenceRolloutBuffer, first: int, starts: set[tuple[int, int]] = frozenset()) -> None:  # type: ignore[assignment]
    """Frame t of environment e holds 10 t + e."""
    for t in range(first, first + STEPS):
        value = np.array([10 * t, 10 * t + 1], np.float32)
        store.add(
            {"road": value[:, None], "images": value[:, None].astype(np.uint8)},
            np.stack([value, value], 1),
            value,
            np.array([(t, e) in starts for e in range(ENVS)]),
            torch.tensor(value),
            torch.tensor(value),
        )


def test_segments_are_contiguous_and_each_comes_once() -> None:
    store = buffer()
    fill(store, 0)
    seen = []
    for batch in store.get(SEGMENT):
        own = placed(batch)[0, PREFIX:]
        assert torch.equal(own, batch.old_values)
        assert torch.equal(own.diff(), torch.full((SEGMENT - 1,), 10.0))
        assert batch.observations["images"].dtype == torch.uint8
        seen += own.tolist()
    assert sorted(seen) == sorted(10.0 * t + e for t in range(STEPS) for e in range(ENVS))


def test_the_prefix_is_the_end_of_the_rollout_before() -> None:
    store = buffer()
    fill(store, 0, {(6, 0)})
    store.reset()
    fill(store, STEPS)
    for batch in store.get(SEGMENT):
        frames = placed(batch)[0]
        if frames[PREFIX] in (80.0, 81.0):
            e = float(frames[PREFIX]) - 80
            # What comes before an episode's start is in no window.
            assert frames[:PREFIX].tolist() == [80 if e == 0 else 51, 60 + e, 70 + e]
            assert batch.observations[STARTS][0, :PREFIX].tolist() == [False, e == 0, False]


def test_each_frame_of_a_minibatch_comes_once() -> None:
    store = buffer()
    fill(store, 0)
    store.reset()
    fill(store, STEPS, {(STEPS + SEGMENT, 0)})
    (batch,) = store.get(None)
    frames = batch.observations["road"].ravel().tolist()
    assert sorted(frames) == sorted(10.0 * t + e for t in range(STEPS - PREFIX, 2 * STEPS) for e in range(ENVS))
    rows = placed(batch)
    assert torch.equal(rows[:, PREFIX:].ravel(), batch.old_values)
    for row in rows:
        cut = float(row[PREFIX]) == 10.0 * (STEPS + SEGMENT)
        assert (len(row.unique()) == SEGMENT) == cut, "the segment that begins with an episode needs no prefix"


def test_embeddings_take_the_place_of_what_they_are_made_from() -> None:
    boxes = {key: spaces.Box(-1, 1, (width,), np.float32) for key, width in (("vehicle", 4), ("road", 9))}
    space = spaces.Dict({"images": spaces.Box(0, 255, (6, 3, 8, 8), np.uint8), **boxes})
    assert stored_arrays(space, {"bev": (4, 8)}) == {
        "vehicle": ((4,), np.float32), "road": ((9,), np.float32), "embedding.bev": ((4, 8), np.float32),
    }  # fmt: skip
    assert stored_arrays(space, {"vr": (1, 16)}) == {
        "images": ((6, 3, 8, 8), np.uint8), "embedding.vr": ((1, 16), np.float32),
    }  # fmt: skip


def test_forgetting_the_prefix_marks_it_as_another_episode() -> None:
    store = buffer()
    fill(store, 0)
    store.reset()
    store.forget_prefix()
    assert store.starts[:PREFIX].all()


def test_states_follow_their_segments() -> None:
    store = buffer(prefix=0)
    for t in range(0, STEPS, SEGMENT):
        store.add_state({"bev": (torch.tensor([[10.0 * t], [10.0 * t + 1]]),)})
    fill(store, 0)
    for batch in store.get(2 * SEGMENT):
        first = batch.observations["road"].reshape(2, SEGMENT)[:, :1]
        assert torch.equal(batch.observations[STATE]["bev"][0], first)


def test_single_transitions_are_refused() -> None:
    with pytest.raises(TypeError, match="segments"):
        buffer()._get_samples(np.array([0]))
