"""Lab, and the nearest and distinct colours in it."""

import torch

from scenes import rand
from stylesplat.imaging.color import cells, distinct, lab_from_rgb, nearest_colors, tone_curve


def test_lab_of_the_primaries_and_of_grey():
    """As published for sRGB and D65; white is 100, and grey has no hue."""
    expected = [[53.24, 80.09, 67.20], [87.73, -86.18, 83.18], [32.30, 79.19, -107.86]]
    found = lab_from_rgb(torch.eye(3))
    torch.testing.assert_close(found, torch.tensor(expected), atol=0.02, rtol=0)
    lab = lab_from_rgb(torch.linspace(0, 1, 9)[:, None].expand(9, 3))
    assert lab[0].abs().max() < 1e-3 and abs(lab[-1, 0] - 100) < 1e-3
    assert lab[:, 1:].abs().max() < 0.02  # the white of the matrix has seven digits


def test_the_nearest_color_is_the_nearest():
    lab, palette = lab_from_rgb(rand(300, 3)), lab_from_rgb(rand(50, 3, seed=1))
    found = (lab - palette[nearest_colors(lab, palette)]).norm(dim=1)
    torch.testing.assert_close(found, torch.cdist(lab, palette).amin(dim=1), atol=1e-2, rtol=0)


def test_each_cube_has_one_color():
    rgb = rand(4000, 3)
    few = distinct(rgb, 20.0)
    places = cells(lab_from_rgb(rgb), 20.0)
    assert len(few) == len(places.unique()) < 400
    assert len(distinct(rgb, 1e-3)) == len(rgb)


def test_tones_come_to_the_paintings_and_keep_their_order():
    """Skewed tones of the same mean and deviation, which an affine map would leave as they are."""
    generator = torch.Generator().manual_seed(0)
    skewed = torch.rand(20_000, generator=generator) ** 4
    painting = (0.45 + 0.15 * torch.randn(20_000, generator=generator)).clamp(0.05, 0.9)
    source = (skewed - skewed.mean()) / skewed.std() * painting.std() + painting.mean()
    mapped = tone_curve(source, painting)(source)
    levels = torch.tensor([0.5, 0.9, 0.98])
    before, after, wanted = (each.quantile(levels) for each in (source, mapped, painting))
    assert (after - wanted).abs().max() < 0.6 * (before - wanted).abs().max()
    assert mapped.min() >= painting.min() and mapped.max() <= painting.max()
    order = source.argsort()
    assert (mapped[order].diff() >= 0).all()
    flat = tone_curve(torch.full((100,), 0.5), painting)(torch.full((100,), 0.5))
    assert flat.isfinite().all()
