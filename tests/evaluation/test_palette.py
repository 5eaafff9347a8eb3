"""Laws of Lab, of palettes and of their distances."""

import pytest
import torch

from stylesplat.evaluation.palette import TOLERANCE, off_palette, palette_distance
from stylesplat.metrics.lab import PIXELS, cells, distinct, lab_from_rgb, nearest_colors


def colors(count: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))


def test_lab_of_the_primaries():
    """As published for sRGB and D65."""
    expected = [[53.24, 80.09, 67.20], [87.73, -86.18, 83.18], [32.30, 79.19, -107.86]]
    found = lab_from_rgb(torch.eye(3))
    torch.testing.assert_close(found, torch.tensor(expected), atol=0.02, rtol=0)


def test_white_is_100_and_grey_has_no_hue():
    grey = torch.linspace(0, 1, 9)[:, None].expand(9, 3)
    lab = lab_from_rgb(grey)
    assert lab[0].abs().max() < 1e-3 and abs(lab[-1, 0] - 100) < 1e-3
    assert lab[:, 1:].abs().max() < 0.02  # the white of the matrix has seven digits


def test_the_nearest_color_is_the_nearest():
    lab, palette = lab_from_rgb(colors(300)), lab_from_rgb(colors(50, seed=1))
    found = (lab - palette[nearest_colors(lab, palette)]).norm(dim=1)
    torch.testing.assert_close(found, torch.cdist(lab, palette).amin(dim=1), atol=1e-2, rtol=0)


def test_each_cube_has_one_color():
    rgb = colors(4000)
    few = distinct(rgb, 20.0)
    places = cells(lab_from_rgb(rgb), 20.0)
    assert len(few) == len(places.unique()) < 400
    assert len(distinct(rgb, 1e-3)) == len(rgb)


def test_a_picture_is_on_its_own_palette():
    picture = colors(3 * PIXELS)
    assert off_palette(picture, picture) == 0
    assert palette_distance(picture, picture) == 0


@pytest.mark.parametrize(("away", "expected"), [(TOLERANCE - 0.5, 0.0), (TOLERANCE + 0.5, 0.25)])
def test_what_is_farther_than_10_is_off(away: float, expected: float):
    """L of grey is a third power of what sRGB makes of it."""
    light = torch.tensor([40.0, 40.0 + away])
    grey = ((light + 16) / 116) ** 3
    grey = 1.055 * grey ** (1 / 2.4) - 0.055
    assert (
        off_palette(grey[[0, 0, 0, 1], None].expand(4, 3), grey[:1, None].expand(1, 3)) == expected
    )


def test_one_color_far_from_a_picture_is_off():
    grey = torch.linspace(0, 1, 256)[:, None].expand(256, 3)
    assert off_palette(torch.tensor([[1.0, 0.0, 0.0]]), grey) == 1


def test_the_distance_of_palettes_is_of_shares_too():
    black, white = torch.zeros(60, 3), torch.ones(60, 3)
    one, other = torch.cat([black, white[:20]]), torch.cat([black[:20], white])
    assert off_palette(one, other) == 0
    # half of all goes from black to white; 100 apart in L alone, seen from directions at random
    expected = 100 * (0.5 / 3) ** 0.5
    assert palette_distance(one, other) == pytest.approx(expected, rel=0.15)
    assert palette_distance(one, other) == pytest.approx(palette_distance(other, one))
    assert palette_distance(one, other, seed=1) != palette_distance(one, other)
