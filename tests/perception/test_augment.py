"""Frames changed so that one town's colours and widths are not learned by heart."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from me3bev_cli.perception.augment import STRETCH, Change, Stretch, changed, draw_change, outside
from me3bev_cli.perception.batches import Pool
from me3bev_cli.perception.frames import Frames
from me3bev_cli.perception.truth import CELLS

DEVICE = torch.device("cpu")


def twice() -> Stretch:
    """Everything twice as large along the rows, as it is along the columns."""
    borders = np.arange(CELLS + 1.0)
    return Stretch((borders - CELLS / 2) / 2 + CELLS / 2, borders)


def frame(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    images = rng.integers(0, 256, (6, 3, 8, 12), dtype=np.uint8)
    maps = rng.integers(0, 8, (CELLS, CELLS), dtype=np.uint8)
    return images, maps, rng.integers(0, 256, (6, 4, 2, 3), dtype=np.uint8)


def test_a_map_is_taken_from_where_the_stretch_says() -> None:
    """Of a map of twice the size the middle half is left, each of its rows two rows."""
    images, maps, depth = frame(np.random.default_rng(0))
    same_images, stretched, same_depth = changed(images, maps, depth, Change(False, None, twice()), [])
    np.testing.assert_array_equal(stretched, np.repeat(maps[50:150], 2, axis=0))
    assert same_images is images
    assert same_depth is depth
    assert not outside(twice()).any()


def test_cells_from_outside_of_the_map_are_told_and_do_not_count() -> None:
    borders = np.arange(CELLS + 1.0)
    half = Stretch((borders - CELLS / 2) * 2 + CELLS / 2, borders)
    expected = np.ones((CELLS, CELLS), bool)
    expected[50:150] = False
    np.testing.assert_array_equal(outside(half), expected)
    images, maps, depth = frame(np.random.default_rng(0))
    pool = Pool(8, None, hidden=0.5, grid=50)
    pool.add([Frames(images[None], maps[None], depth[None], 1)])
    batch = pool.batch(np.array([0, 0]), [Change(False, None, half), Change(False)], DEVICE)
    assert bool((batch.cells[0][torch.from_numpy(expected)] == 0).all())
    assert bool((batch.cells[1] > 0).all())
    assert batch.stretch is not None
    centres = (torch.arange(50) + 0.5) / 25 - 1
    torch.testing.assert_close(batch.stretch[1], torch.stack([centres, centres]))
    torch.testing.assert_close(batch.stretch[0, 0], 2 * centres)


def test_drawn_stretches_rise_and_leave_the_ego_in_the_middle() -> None:
    rng = np.random.default_rng(0)
    steps = []
    for _ in range(50):
        stretch = draw_change(rng, True, 0.0, 1.0).stretch
        assert stretch is not None
        for axis in stretch:
            assert axis[CELLS // 2] == pytest.approx(CELLS / 2)
            steps.append(np.diff(axis))
    assert np.min(steps) >= 1 / STRETCH - 1e-9
    assert np.max(steps) <= STRETCH + 1e-9
    assert np.std(steps) > 0.2


def test_colours_keep_their_order_and_black_stays_dark() -> None:
    """A table per colour that never falls: what was lighter is not darker afterwards."""
    rng = np.random.default_rng(0)
    tables = [draw_change(rng, True, 1.0, 0.0).colours for _ in range(20)]
    for table in tables:
        assert table is not None
        assert (np.diff(table.astype(int)) >= 0).all()
        assert table[:, 0].max() < 30
    assert draw_change(rng, True, 0.0, 0.0).colours is None
    images, maps, depth = frame(rng)
    table = np.stack([np.full(256, value, np.uint8) for value in (1, 2, 3)])
    shifted, _, _ = changed(images, maps, depth, Change(False, table), [])
    np.testing.assert_array_equal(shifted, np.broadcast_to(np.array([1, 2, 3])[:, None, None], images.shape))


def test_nothing_is_mirrored_where_the_cameras_are_not_symmetric() -> None:
    rng = np.random.default_rng(0)
    assert not any(draw_change(rng, False, 0.0, 0.0).turned for _ in range(50))
    turned = [draw_change(rng, True, 0.0, 0.0).turned for _ in range(200)]
    assert 60 < sum(turned) < 140
