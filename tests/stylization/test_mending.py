"""Colours that are continued over a fault."""

import pytest
import torch

from scenes import random_splats
from stylesplat.errors import StyleSplatError
from stylesplat.scene.splats import Splats
from stylesplat.stylization.mending import mended_bands


def wall(side: int = 24) -> Splats:
    """A flat grid whose red grows to the right, and green upwards."""
    x, y = torch.meshgrid(torch.arange(side), torch.arange(side), indexing="xy")
    means = torch.stack([x, y, 0 * x], dim=-1).reshape(-1, 3).float()
    splats = random_splats(len(means))
    colors = means / side
    return Splats(
        means=means,
        quats=splats.quats,
        scales=splats.scales,
        opacities=torch.full((len(means),), 4.0),
        sh0=colors[:, None],
        shN=colors[:, None].expand(-1, 3, 3).clone(),
    )


def test_a_hole_is_filled_as_smooth_as_its_surroundings():
    """A linear slope is harmonic: it is continued as it is."""
    whole = wall()
    broken = ((whole.means[:, :2] - 11.5).abs() < 4).all(dim=1)
    spoiled = whole.with_rows(
        broken.nonzero()[:, 0], {"sh0": torch.full_like(whole.sh0[broken], 9)}
    )
    sh0, shN = mended_bands(spoiled, broken, broken.nonzero()[:, 0])
    torch.testing.assert_close(sh0, whole.sh0[broken], atol=0.02, rtol=0)
    torch.testing.assert_close(shN, whole.shN[broken], atol=0.02, rtol=0)


def test_where_nothing_solid_is_left_it_says_so():
    splats = wall(6)
    everything = torch.ones(len(splats), dtype=torch.bool)
    with pytest.raises(StyleSplatError, match="Nothing solid"):
        mended_bands(splats, everything, torch.arange(len(splats)))
