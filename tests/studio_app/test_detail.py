"""Fewer Gaussians in place of many."""

from dataclasses import replace

import torch

from balls import CAMERAS, SPLATS
from stylesplat.rendering.render import render
from stylesplat.scene.projection import is_in_image
from stylesplat.scene.splats import Splats
from stylesplat.studio_app.detail import ReducedSplats, most_visible

COPIES = 20


def many() -> Splats:
    """The balls of small Gaussians, which are of very different sizes."""
    generator = torch.Generator().manual_seed(1)
    splats = SPLATS[torch.arange(len(SPLATS)).repeat(COPIES)]
    jitter = torch.randn(len(splats), 3, generator=generator)
    smaller = torch.rand(len(splats), 1, generator=generator) * 1.5
    means = splats.means + jitter * splats.scales.exp()
    return replace(splats, means=means, scales=splats.scales - smaller)


def areas(splats: Splats) -> torch.Tensor:
    sides = splats.scales.exp().sort(dim=1).values
    return splats.opacities.sigmoid() * sides[:, 1] * sides[:, 2]


def test_rows_of_the_largest_areas():
    opacities = torch.linspace(-3, 3, len(SPLATS))
    rows = most_visible(replace(SPLATS, opacities=opacities), 100)
    assert rows.tolist() == [*range(len(SPLATS) - 100, len(SPLATS))]
    assert most_visible(SPLATS, 10**9).tolist() == [*range(len(SPLATS))]


def test_a_part_covers_as_much_as_all():
    splats, camera = many(), CAMERAS[0]
    part = ReducedSplats(splats).seen_from(camera, len(splats) // 4)
    assert len(part) <= len(splats) // 4 + 1 and part.identities is None
    ratio = float(areas(part).sum() / areas(splats).sum())
    assert 0.95 < ratio < 1.05
    (image, alphas), (fewer, fewer_alphas) = (render(each, camera) for each in (splats, part))
    assert abs(float(alphas.mean() - fewer_alphas.mean())) < 0.06 * float(alphas.mean())
    dropped, _ = render(splats[: len(part)], camera)
    error, plain = (float((each - image).square().mean()) for each in (fewer, dropped))
    assert error < 0.5 * plain, "better than the same number as they are"


def test_what_few_are_in_view_of_is_whole():
    splats, camera = many(), CAMERAS[0]
    part = ReducedSplats(splats)
    assert len(part.seen_from(camera, len(splats))) == len(splats)
    near = replace(camera, Ks=camera.Ks * torch.tensor([8.0, 8.0, 1.0])[:, None])
    near.Ks[:, :2, 2] = camera.Ks[:, :2, 2]
    seen = int(is_in_image(splats.means, near).sum())
    assert 0 < seen < len(splats) // 3
    assert len(part.seen_from(camera, 2 * seen)) < len(splats)
    assert torch.equal(part.seen_from(near, 2 * seen).scales, splats.scales)
