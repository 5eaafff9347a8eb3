"""What of a pick lies on the surface that the object stands on."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from balls import SPLATS
from stylesplat.scene.splats import Splats
from stylesplat.selection.contacts import find_support, on_support

SIDE = 0.3  # of a box that stands on a table of 2 x 2, with a shadow to its right
SHADOW = 0.6  # how far that reaches


def splats_at(means: Tensor) -> Splats:
    """Small opaque Gaussians."""
    rows = SPLATS[torch.full((len(means),), 210)]
    small, opaque = torch.full_like(rows.scales, -4.5), torch.full_like(rows.opacities, 4.0)
    return replace(rows, means=means, scales=small, opacities=opaque)


def table(generator: torch.Generator) -> Tensor:
    """Its top, at z = 0, somewhat rough."""
    means = 2 * torch.rand(4000, 3, generator=generator) - 1
    return means * torch.tensor([1.0, 1.0, 0.003])


def box(generator: torch.Generator) -> Tensor:
    """The sides and the top of a box over the middle of the table."""
    means = SIDE * (torch.rand(1500, 3, generator=generator) - 0.5)
    face = torch.randint(5, (1500,), generator=generator)
    for axis in (0, 1):
        for side in (0, 1):
            means[face == 2 * axis + side, axis] = SIDE * (side - 0.5)
    means[face == 4, 2] = SIDE / 2
    return means + torch.tensor([0.0, 0.0, SIDE / 2 + 0.01])


@pytest.fixture
def scene() -> tuple[Splats, Tensor, Tensor]:
    """The box on the table, a pick of it with its shadow, and what is the box."""
    generator = torch.Generator().manual_seed(0)
    top, standing = table(generator), box(generator)
    means = torch.cat([top, standing])
    is_box = torch.arange(len(means)) >= len(top)
    x, y = means[:, 0], means[:, 1]
    shadow = ~is_box & (x > 0) & (x < SHADOW) & (y.abs() < SIDE / 2)
    return splats_at(means), is_box | shadow, is_box


def test_a_shadow_is_left_and_the_object_kept(scene: tuple[Splats, Tensor, Tensor]):
    splats, picked, is_box = scene
    found = on_support(splats, picked)
    away = picked & ~is_box & (splats.means[:, 0] > SIDE / 2 + 0.1)
    assert away.sum() > 50 and found[away].float().mean() > 0.9
    assert found[is_box].float().mean() < 0.01
    assert not found[~picked].any()


def test_of_two_surfaces_the_one_that_it_stands_on(scene: tuple[Splats, Tensor, Tensor]):
    """A wall near by has more Gaussians."""
    splats, picked, is_box = scene
    y, z = 0.4 * torch.rand(2, 3000, generator=torch.Generator().manual_seed(1)) - 0.2
    wall = torch.stack([torch.full_like(y, -SIDE / 2 - 0.07), y, z + 0.25], dim=1)
    both = splats_at(torch.cat([splats.means, wall]))
    mine = torch.cat([picked, torch.zeros(len(wall), dtype=torch.bool)])
    surface = find_support(both, mine)
    assert surface is not None and surface.normal[2] > 0.99
    assert on_support(both, mine)[: len(is_box)][is_box].float().mean() < 0.02


def test_a_sheet_on_the_table_is_an_object(scene: tuple[Splats, Tensor, Tensor]):
    splats, _, is_box = scene
    sheet = ~is_box & (splats.means[:, :2].abs() < 0.4).all(dim=1)
    assert not on_support(splats, sheet).any()


def test_what_stands_on_nothing(scene: tuple[Splats, Tensor, Tensor]):
    splats, _, is_box = scene
    hanging = replace(splats, means=splats.means + is_box[:, None] * torch.tensor([0, 0, 0.5]))
    assert not on_support(hanging, is_box).any()


def test_nothing_around_or_hardly_anything_picked(scene: tuple[Splats, Tensor, Tensor]):
    splats, _, is_box = scene
    alone = splats[is_box]
    assert not on_support(alone, torch.ones(len(alone), dtype=torch.bool)).any()
    few = is_box & (is_box.cumsum(0) <= 10)
    assert not on_support(splats, few).any()
