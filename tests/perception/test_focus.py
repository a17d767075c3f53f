"""Tokens that are finer in the middle of the map: where they lie, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from me3bev_cli.api import TokenSpec
from me3bev_cli.decoding.decoder import LatentSpec, SemanticDecoder
from me3bev_cli.perception.focus import even_places, laid_out_evenly
from me3bev_cli.perception.head import SegmentationHead
from me3bev_plugins.spatial.bev_trunk import BEVTrunk

FOCUSED = TokenSpec(12, 12, 6, 2.0)


def test_places_rise_from_border_to_border_and_are_finest_in_the_middle() -> None:
    at = np.linspace(-1, 1, 101)
    places = FOCUSED.place(at)
    steps = np.diff(places)
    assert places[0] == pytest.approx(-1)
    assert places[-1] == pytest.approx(1)
    assert steps.min() > 0
    assert steps[50] / (at[1] - at[0]) == pytest.approx(1 / FOCUSED.focus, rel=1e-2)
    np.testing.assert_allclose(TokenSpec(1, 1, 1).place(at), at)


def test_the_way_back_from_the_map_to_the_tokens() -> None:
    """Each cell of an even map asks the tokens where its own place lies."""
    places = even_places(50, FOCUSED)
    centres = (torch.arange(50) + 0.5) / 25 - 1
    back = FOCUSED.place(places.double())
    torch.testing.assert_close(back[..., 0], centres.double().expand(50, 50), atol=1e-5, rtol=0)
    torch.testing.assert_close(back[..., 1], centres.double()[:, None].expand(50, 50), atol=1e-5, rtol=0)


def test_what_tokens_see_comes_back_where_it_was() -> None:
    """A blob in the grid, sampled by the trunk's places and laid out evenly again, is at its own cell."""
    trunk = BEVTrunk(1, (4, 4, 4), 1, FOCUSED)
    size = 96
    for row, column in ((48, 48), (40, 60), (20, 80)):
        rows, columns = torch.meshgrid(torch.arange(size), torch.arange(size), indexing="ij")
        blob = torch.exp(-((rows - row) ** 2 + (columns - column) ** 2) / 60.0)[None, None]
        even = laid_out_evenly(trunk._sampled(blob), even_places(size, FOCUSED))[0, 0]
        found = divmod(int(even.argmax()), size)
        assert abs(found[0] - row) <= 2
        assert abs(found[1] - column) <= 2


def test_heads_and_decoders_lay_out_their_maps() -> None:
    """Their scores differ from those of even tokens, and nothing more than places is added to them."""
    latents = torch.randn(1, 6, 12, 12)
    torch.manual_seed(0)
    plain = SegmentationHead(6, (12, 12), 8)
    focused = SegmentationHead(6, (12, 12), 8, FOCUSED)
    focused.load_state_dict(plain.state_dict())
    assert focused(latents).shape == (1, 8, 200, 200)
    assert not torch.allclose(focused(latents), plain(latents))
    middle = [head(latents)[..., 99:101, 99:101].mean() for head in (focused, plain)]
    torch.testing.assert_close(*middle, atol=0.2, rtol=0)  # There both look at the same place.
    even, uneven = (SemanticDecoder(LatentSpec(6, 12, 12, focus)).eval() for focus in (1.0, 2.0))
    uneven.load_state_dict(even.state_dict())
    assert uneven(latents).shape == (1, 8, 200, 200)
    assert not torch.allclose(uneven(latents), even(latents))
