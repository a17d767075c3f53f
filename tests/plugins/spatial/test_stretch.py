"""A stretched grid against interpolation by hand in float64, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from me3bev_plugins.spatial.stretch import stretched


def by_hand(grid: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Bilinear, 0 outside; (X, X) at places from -1 to 1."""
    size = len(grid)
    padded = np.pad(grid, 1)
    out = np.zeros((size, size))
    for i, row in enumerate((rows + 1) / 2 * size + 0.5):
        for j, column in enumerate((columns + 1) / 2 * size + 0.5):
            if not (0 <= row < size + 1 and 0 <= column < size + 1):
                continue
            top, left = int(row), int(column)
            a, b = row - top, column - left
            upper = (1 - b) * padded[top, left] + b * padded[top, left + 1]
            lower = (1 - b) * padded[top + 1, left] + b * padded[top + 1, left + 1]
            out[i, j] = (1 - a) * upper + a * lower
    return out


def test_rows_and_columns_are_taken_from_where_the_places_say() -> None:
    generator = torch.Generator().manual_seed(0)
    grid = torch.rand(2, 3, 8, 8, dtype=torch.float64, generator=generator)
    places = (2.4 * torch.rand(2, 2, 8, dtype=torch.float64, generator=generator) - 1.2).sort(2).values
    found = stretched(grid, places)
    for n in range(2):
        for channel in range(3):
            expected = by_hand(grid[n, channel].numpy(), places[n, 0].numpy(), places[n, 1].numpy())
            np.testing.assert_allclose(found[n, channel].numpy(), expected, atol=1e-12)
    grid.requires_grad_()
    assert torch.autograd.gradcheck(lambda x: stretched(x, places), grid)


def test_the_cells_own_places_change_nothing() -> None:
    grid = torch.rand(1, 2, 10, 10)
    centres = ((torch.arange(10) + 0.5) / 5 - 1).expand(1, 2, 10)
    torch.testing.assert_close(stretched(grid, centres), grid)
    coarser = ((torch.arange(5) + 0.5) / 2.5 - 1).expand(1, 2, 5)
    torch.testing.assert_close(stretched(grid, coarser)[..., 1:-1, 1:-1], grid[..., 1:-1, 1:-1])


def test_places_for_another_grid_are_refused() -> None:
    with pytest.raises(ValueError, match="places"):
        stretched(torch.rand(1, 2, 10, 8), torch.zeros(1, 2, 10))
