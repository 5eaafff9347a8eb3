"""Objects come back to the colours of a painting, and no farther than they have to."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, FAST, SPLATS, ball
from balls import STRIPED_SCENE as SCENE
from stylesplat.evaluation.statistics import TOLERANCE, off_palette
from stylesplat.metrics.lab import lab_from_rgb, nearest_colors
from stylesplat.scene.splats import SH_C0
from stylesplat.stylization.colors import (
    NEAR,
    build_palette,
    object_colors,
    project_to_palette,
)
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.paint import paint
from stylesplat.stylization.views import ObjectView, crop_views, find_boxes

GREY = torch.linspace(0, 1, 2000)[:, None].expand(2000, 3)


@pytest.fixture(scope="module", params=[1e9, 0.0], ids=["linear", "rasterised"])
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    boxes = find_boxes(SPLATS, CAMERAS[:4], ball(0))
    return crop_views(
        SPLATS, boxes, ball(0), [network.cells(2)], zoom=2.0, max_memory=request.param
    )


def test_a_painting_leaves_its_own_colors_alone():
    style = torch.rand(5000, 3, generator=torch.Generator().manual_seed(0))
    near = build_palette(style)
    assert (near.offset(style) == 0).float().mean() > 0.99  # cubes at the edge are cut off


def test_the_way_back_ends_near_the_painting_and_no_nearer():
    far = torch.tensor([[0.9, 0.1, 0.1], [0.1, 0.1, 0.9], [0.2, 0.9, 0.4]])
    ends = lab_from_rgb(far + build_palette(GREY).offset(far))
    grey = lab_from_rgb(GREY)
    away = (ends - grey[nearest_colors(ends, grey)]).norm(dim=1)
    # the way is straight in RGB, the distance is told in Lab
    assert ((away > NEAR / 2) & (away < TOLERANCE)).all(), away


def test_the_distance_pulls_only_what_is_far():
    rgb = [[0.9, 0.1, 0.1], [0.5, 0.5, 0.5], [0.1, 0.1, 0.9]]
    image = torch.tensor([rgb], requires_grad=True)
    near, mask = build_palette(GREY), torch.tensor([[True, True, False]])
    distance = near.distance(image, mask)
    distance.backward()
    assert image.grad is not None
    far, grey, others = image.grad[0]
    assert far[0] > 0 > far[1] and (grey == 0).all() and (others == 0).all()
    expected = near.offset(image[0, :1]).square().sum() / 2
    torch.testing.assert_close(distance.detach(), expected)


def test_settling_brings_pixels_to_the_painting(views: list[ObjectView]):
    picked = ball(0)
    before = off_palette(object_colors(SPLATS, views), GREY)
    settled = project_to_palette(SPLATS, picked, views, build_palette(GREY))
    after = off_palette(object_colors(settled, views), GREY)
    assert before > 0.9 and after < 0.5 * before
    assert torch.equal(settled.sh0[~picked], SPLATS.sh0[~picked])
    assert torch.equal(settled.shN, SPLATS.shN)


def test_what_is_on_the_palette_stays_to_the_bit(views: list[ObjectView]):
    every = torch.cartesian_prod(*[torch.linspace(0, 1, 24)] * 3)
    settled = project_to_palette(SPLATS, ball(0), views, build_palette(every))
    torch.testing.assert_close(settled.sh0, SPLATS.sh0, atol=1e-5, rtol=0)  # there and back


def test_a_grey_painting_gives_a_grey_object(network: FeatureNetwork):
    grey = torch.rand(40, 48, 1, generator=torch.Generator().manual_seed(0)).expand(40, 48, 3)
    picked = ball(0)
    config = replace(FAST, steps=40)
    styled = paint(SCENE, CAMERAS, picked, grey, config=config, network=network)
    own = (styled.sh0 != SCENE.sh0).any(dim=2)[:, 0]
    assert own.sum() > 0.5 * picked.sum()
    pairs = [each.sh0[own, 0] * SH_C0 + 0.5 for each in (styled, SCENE)]
    hues = [colors.amax(dim=1) - colors.amin(dim=1) for colors in pairs]
    assert hues[0].mean() < 0.1 < hues[1].mean()
