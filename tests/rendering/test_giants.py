"""Gaussians that each cover the whole picture: their lists are made and blended in groups."""

import pytest
import torch

from scenes import leaf, rand, randn
from stylesplat.rendering.render import rasterize, render
from stylesplat.rendering.visibility import in_view, visible
from stylesplat.rendering.weights import contributions
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.splats import Splats, rgb_from_sh0, sh0_from_rgb

COUNT = 1700  # of 3420 tiles each: more than 4 million entries
CORNER = 48  # pixels, of which one group's lists are enough
K = torch.tensor([[900.0, 0.0, 20.0], [0.0, 900.0, 20.0], [0.0, 0.0, 1.0]])


def camera(width: int, height: int) -> Cameras:
    """One that looks along z, at its left upper corner, so that smaller ones see a part."""
    return Cameras(torch.eye(4)[None], K[None], torch.tensor([[width, height]]), ("a.png",))


WHOLE, PART = camera(960, 900), camera(CORNER, CORNER)


def faint() -> Splats:
    """The light lasts for more than one group of them, but not for all."""
    return Splats(
        means=torch.cat([0.003 * randn(COUNT, 2), 1 + rand(COUNT, 1)], dim=1),
        quats=randn(COUNT, 4, seed=1),
        scales=2 + 0.2 * randn(COUNT, 3),
        opacities=torch.logit(0.006 + 0.002 * rand(COUNT, seed=2)),
        sh0=randn(COUNT, 1, 3, seed=3),
        shN=torch.zeros(COUNT, 0, 3),
    )


def bars() -> Splats:
    """Opaque ones before all of the picture but its corner, where blending so ends soon."""
    centres = (torch.arange(130.0, 1040.0, 20.0) - 20) * 0.5 / 900
    none, count = torch.zeros_like(centres), 2 * len(centres)
    depth = torch.full((count, 1), 0.5)
    places = torch.cat([torch.stack([centres, none], 1), torch.stack([none, centres], 1)])
    wide, thin = torch.tensor([3.0, -8.0]).expand(count // 2, 2), torch.tensor([20 * 0.5 / 900])
    across = torch.cat([thin.log().expand(count // 2, 1), wide], dim=1)
    return Splats(
        means=torch.cat([places, depth], dim=1),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        scales=torch.cat([across, across[:, [1, 0, 2]]]),
        opacities=torch.full((count,), 9.0),
        sh0=sh0_from_rgb(torch.full((count, 1, 3), 0.5)),
        shN=torch.zeros(count, 0, 3),
    )


@pytest.fixture(scope="module")
def giants() -> Splats:
    return Splats.cat([bars(), faint()])


def test_the_picture_is_that_of_its_parts_to_the_bit(giants: Splats):
    image, alphas = render(giants, WHOLE)
    part, part_alphas = render(giants, PART)
    assert torch.equal(image[:CORNER, :CORNER], part)
    assert torch.equal(alphas[:CORNER, :CORNER], part_alphas)
    assert part_alphas.min() > 0.999
    # long after the 4 million entries of the first group
    order = giants.means[:, 2].argsort()
    assert render(giants[order[: (1 << 22) // 3420]], PART)[1].max() < 0.9999


def test_gradients_and_contributions_are_those_of_the_part(giants: Splats):
    weights, found = randn(CORNER, CORNER, 3), []
    for view in (WHOLE, PART):
        splats = leaf(giants, torch.float32)
        image, _, _ = rasterize(splats, view)
        (image[0, :CORNER, :CORNER] * weights).sum().backward()
        found.append([each.grad for each in splats.tensors().values()])
    for whole, part in zip(*found, strict=True):
        assert whole is not None and part is not None
        assert (whole - part).norm() <= 1e-5 * part.norm()  # sums in another order
    every = torch.ones(len(giants), dtype=torch.bool)
    whole, part = (contributions(giants, view, every) for view in (WHOLE, PART))
    assert torch.equal(whole.coverage[:CORNER, :CORNER], part.coverage)
    colors = rgb_from_sh0(giants.sh0[:, 0]).relu()
    images = [each.render(colors[each.gaussians]) for each in (whole, part)]
    assert torch.equal(images[0][:CORNER, :CORNER], images[1])


def test_what_is_behind_all_light_is_not_visible(giants: Splats):
    """Though the picture ends within a tile."""
    rows = [visible(in_view(giants, view), view).rows for view in (WHOLE, PART)]
    last = giants.means[:, 2].argsort(descending=True)[:100]
    assert set(rows[1].tolist()) <= set(rows[0].tolist())
    assert not torch.isin(last, torch.cat(rows)).any()
