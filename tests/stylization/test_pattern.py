"""Patterns go, light stays."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, COUNT, LIGHT, PICKED, WAYS, assert_same_splats
from balls import dense_ball as ball
from stylesplat.scene.splats import Splats, sh0_from_rgb
from stylesplat.stylization.colors import blur_colors, remove_pattern
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.views import ObjectView, crop_views, find_boxes

PATTERN = 0.25  # of its colours, up and down
GENERATOR = torch.Generator().manual_seed(1)
NOISE = PATTERN * (2 * torch.randint(2, (COUNT, 1), generator=GENERATOR) - 1)
LENGTH = 24.0  # pixels of the ball in the views


def rgb(splats: Splats) -> torch.Tensor:
    return 0.5 + (splats.sh0[PICKED, 0] - sh0_from_rgb(torch.full((1, 3), 0.5))) * 0.28209479


@pytest.fixture(scope="module", params=[1e9, 0.0], ids=["linear", "rasterised"])
def views(request: pytest.FixtureRequest, network: FeatureNetwork) -> list[ObjectView]:
    splats = ball(LIGHT)
    boxes = find_boxes(splats, CAMERAS, PICKED)
    return crop_views(splats, boxes, PICKED, [network.cells(2)], zoom=1.0, max_memory=request.param)


def test_the_pattern_goes_and_the_light_stays(views: list[ObjectView]):
    shown = WAYS[:, 2] > -0.3  # no camera looks from below
    calm = rgb(remove_pattern(ball(LIGHT + NOISE), PICKED, views, LENGTH, 1.0))
    assert (calm - LIGHT)[shown].std() < 0.3 * PATTERN
    slope = torch.linalg.lstsq(LIGHT[shown, :1] - 0.5, calm[shown, :1] - 0.5).solution
    assert float(slope) == pytest.approx(1, abs=0.25)


def test_a_share_takes_that_much_away(views: list[ObjectView]):
    splats = ball(LIGHT + NOISE)
    none, half, full = (
        remove_pattern(splats, PICKED, views, LENGTH, share) for share in (0.0, 0.5, 1.0)
    )
    assert_same_splats(none, splats)
    torch.testing.assert_close(half.sh0, (splats.sh0 + full.sh0) / 2)


def test_only_colours_of_the_picked_change(views: list[ObjectView]):
    splats = ball(LIGHT + NOISE)
    bands = 0.1 * torch.randn(len(splats), 3, 3, generator=torch.Generator().manual_seed(1))
    splats = replace(splats, shN=bands)
    calm = remove_pattern(splats, PICKED, views, LENGTH, 1.0)
    assert torch.equal(splats.sh0[~PICKED], calm.sh0[~PICKED])
    assert calm.sh0[PICKED].std() < splats.sh0[PICKED].std()
    assert_same_splats(replace(calm, sh0=splats.sh0), splats)


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
