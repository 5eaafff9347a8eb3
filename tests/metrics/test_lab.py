"""Lab, and the nearest and distinct colours in it."""

import torch

from stylesplat.metrics.lab import cells, distinct, lab_from_rgb, nearest_colors


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
