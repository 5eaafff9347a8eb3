"""Patterns go, light and large shapes stay."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, COUNT, LIGHT, PICKED, WAYS, assert_same_splats
from balls import dense_ball as ball
from stylesplat.rendering.sh import sh0_from_rgb
from stylesplat.scene.splats import Splats
from stylesplat.stylization.colors import blur_colors
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.pattern import remove_pattern
from stylesplat.stylization.views import ObjectView, crop_views, find_boxes

PATTERN = 0.25  # of its colours, up and down
GENERATOR = torch.Generator().manual_seed(1)
NOISE = PATTERN * (2 * torch.randint(2, (COUNT, 1), generator=GENERATOR) - 1)
HALVES = torch.where(WAYS[:, :1] > 0, 0.15, -0.15) * torch.tensor([1.0, 0.0, -1.0])


def rgb(splats: Splats) -> torch.Tensor:
    return 0.5 + (splats.sh0[PICKED, 0] - sh0_from_rgb(torch.full((1, 3), 0.5))) * 0.28209479


@pytest.fixture(scope="module", params=[1e9, 0.0], ids=["linear", "rasterised"])
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    splats = ball(LIGHT)
    boxes = find_boxes(splats, CAMERAS, PICKED)
    return crop_views(splats, boxes, PICKED, [network.cells(2)], zoom=1.0, max_memory=request.param)


def test_the_pattern_goes_and_the_light_stays(views: list[ObjectView]):
    shown = WAYS[:, 2] > -0.3  # no camera looks from below
    calm = rgb(remove_pattern(ball(LIGHT + NOISE), PICKED, views, 1.0))
    assert (calm - LIGHT)[shown].std() < 0.2 * PATTERN
    slope = torch.linalg.lstsq(LIGHT[shown, :1] - 0.5, calm[shown, :1] - 0.5).solution
    assert float(slope) == pytest.approx(1, abs=0.15)


def test_edges_of_large_shapes_stay_sharp(views: list[ObjectView]):
    calm = rgb(remove_pattern(ball(0.5 + HALVES + NOISE / 5), PICKED, views, 1.0))
    shown = WAYS[:, 2] > 0
    for side in (1, -1):
        near = shown & (side * WAYS[:, 0] > 0.2) & (side * WAYS[:, 0] < 0.35)
        contrast = (calm[near, 0] - calm[near, 2]).mean()
        assert float(contrast) == pytest.approx(side * 0.3, abs=0.06)


def test_a_share_takes_that_much_away(views: list[ObjectView]):
    splats = ball(LIGHT + NOISE)
    none, half, full = (remove_pattern(splats, PICKED, views, share) for share in (0.0, 0.5, 1.0))
    assert_same_splats(none, splats)
    torch.testing.assert_close(half.sh0, (splats.sh0 + full.sh0) / 2)


def test_only_colours_of_the_picked_change(views: list[ObjectView]):
    splats = ball(LIGHT + NOISE)
    bands = 0.1 * torch.randn(len(splats), 3, 3, generator=torch.Generator().manual_seed(1))
    splats = replace(splats, shN=bands)
    calm = remove_pattern(splats, PICKED, views, 1.0)
    for name in ("sh0", "shN"):
        before, after = splats.tensors()[name], calm.tensors()[name]
        assert torch.equal(before[~PICKED], after[~PICKED])
        assert after[PICKED].std() < before[PICKED].std()
    assert_same_splats(replace(calm, sh0=splats.sh0, shN=splats.shN), splats)


def test_few_gaussians_at_one_place(views: list[ObjectView]):
    splats = ball(LIGHT + NOISE)
    splats = replace(splats, means=torch.where(PICKED[:, None], splats.means[-1], splats.means))
    assert remove_pattern(splats, PICKED, views, 1.0).sh0.isfinite().all()


def test_blurring_leaves_what_small_renders_show(views: list[ObjectView]):
    """Gaussians smaller than their pixels lose their noise; light stays, and so does the rest."""
    splats = ball(LIGHT + NOISE)
    shown = WAYS[:, 2] > 0
    full = blur_colors(splats, PICKED, views)
    assert (rgb(full) - LIGHT)[shown].std() < 0.4 * PATTERN
    slope = torch.linalg.lstsq(LIGHT[shown, :1] - 0.5, rgb(full)[shown, :1] - 0.5).solution
    assert float(slope) == pytest.approx(1, abs=0.2)
    assert_same_splats(replace(full, sh0=splats.sh0), splats)
    assert torch.equal(full.sh0[~PICKED], splats.sh0[~PICKED])
