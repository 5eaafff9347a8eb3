"""Statistics of features, palettes, and the content that an object keeps."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.evaluation.statistics import (
    TOLERANCE,
    content_ssim,
    object_statistics_distance,
    off_palette,
    palette_distance,
    style_statistics_distance,
)
from stylesplat.metrics.lab import PIXELS
from stylesplat.rendering.render import rasterize
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.style_image import style_features
from stylesplat.stylization.views import ObjectView

PICKED = (torch.arange(len(SPLATS)) >= 200) & (torch.arange(len(SPLATS)) < 280)  # the first ball
BLOCKS = (1, 2)


def rows(count: int, seed: int = 0) -> torch.Tensor:
    return 2 + torch.randn(count, 5, generator=torch.Generator().manual_seed(seed))


def repainted(mask: torch.Tensor, seed: int = 0) -> Splats:
    """The scene with other colours of some Gaussians."""
    noise = torch.randn(SPLATS.sh0.shape, generator=torch.Generator().manual_seed(seed))
    return replace(SPLATS, sh0=SPLATS.sh0 + noise * mask[:, None, None])


def object_views(rows: list[int]) -> list[ObjectView]:
    """Whole views, with features in an arbitrary half of them."""
    views = []
    for row in rows:
        cells = [torch.zeros(36 // s, 48 // s, dtype=torch.bool) for s in (1, 2)]
        for mask in cells:
            mask[:, row : row + 20] = True
        views.append(ObjectView(CAMERAS[row], tuple(cells), cells[0]))
    return views


def test_distance_matches_its_formula():
    x, y = rows(40), 3 * rows(70, seed=1)
    mean = (x.mean(0) - y.mean(0)).norm() / y.mean(0).norm()
    covariances = [t.T.cov(correction=0) for t in (x, y)]
    spread = (covariances[0] - covariances[1]).norm() / covariances[1].norm()
    found = style_statistics_distance(x, y)
    torch.testing.assert_close(found, (mean + spread) / 2)
    torch.testing.assert_close(style_statistics_distance(7 * x, 7 * y), found)
    assert style_statistics_distance(torch.cat([x, x]).flip(0), x) < 1e-6


def test_object_statistics_pool_the_views(network: FeatureNetwork, stripes: torch.Tensor):
    views = object_views([0, 1, 2])
    targets = style_features(stripes, network, BLOCKS, length=48.0)
    rest = (views, targets, network, BLOCKS)
    found = object_statistics_distance(SPLATS, *rest)
    distances = []
    for number, target in enumerate(targets):
        feats = []
        for view in views:
            image = rasterize(SPLATS, view.camera)[0][0].clamp(0, 1)
            feats.append(network(image, BLOCKS)[number][view.cells[number]])
        distances.append(style_statistics_distance(torch.cat(feats), target))
    assert found == pytest.approx(float(sum(distances)) / len(BLOCKS), rel=1e-4)
    assert found > 0.1
    other = repainted(torch.ones(len(SPLATS)))
    assert object_statistics_distance(other, *rest) != found


def test_content_is_the_luminance_of_the_object():
    little, much = (
        replace(SPLATS, sh0=SPLATS.sh0 + f * (repainted(PICKED).sh0 - SPLATS.sh0))
        for f in (0.1, 1.0)
    )
    # A change of hue that keeps Rec. 709's luminance
    hue = torch.tensor([0.0722, 0.0, -0.2126]) * PICKED[:, None, None]
    beside = repainted(torch.arange(len(SPLATS)) >= 280)  # the other balls
    everyone = [SPLATS, replace(SPLATS, sh0=SPLATS.sh0 - 2 * hue), beside, little, much]
    same, recoloured, elsewhere, less, least = (
        content_ssim(SPLATS, styled, CAMERAS[:1], PICKED) or 0.0 for styled in everyone
    )
    assert same == pytest.approx(1, abs=1e-5)  # variances: differences of rounded squares
    assert recoloured == pytest.approx(1, abs=1e-3)
    assert elsewhere > 0.95 and 0.995 > less > least + 0.1
    assert content_ssim(SPLATS, SPLATS, CAMERAS[:2], PICKED & False) is None, "it shows nowhere"


def colors(count: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(seed))


def test_a_picture_is_on_its_own_palette():
    picture = colors(3 * PIXELS)
    assert off_palette(picture, picture) == palette_distance(picture, picture) == 0
    grey = torch.linspace(0, 1, 256)[:, None].expand(256, 3)
    assert off_palette(torch.tensor([[1.0, 0.0, 0.0]]), grey) == 1


@pytest.mark.parametrize(("away", "expected"), [(TOLERANCE - 0.5, 0.0), (TOLERANCE + 0.5, 0.25)])
def test_what_is_farther_than_10_is_off(away: float, expected: float):
    """L of grey is a third power of what sRGB makes of it."""
    light = torch.tensor([40.0, 40.0 + away])
    grey = ((light + 16) / 116) ** 3
    grey = 1.055 * grey ** (1 / 2.4) - 0.055
    assert (
        off_palette(grey[[0, 0, 0, 1], None].expand(4, 3), grey[:1, None].expand(1, 3)) == expected
    )


def test_the_distance_of_palettes_is_of_shares_too():
    black, white = torch.zeros(60, 3), torch.ones(60, 3)
    one, other = torch.cat([black, white[:20]]), torch.cat([black[:20], white])
    assert off_palette(one, other) == 0
    # half of all goes from black to white; 100 apart in L alone, seen from directions at random
    expected = 100 * (0.5 / 3) ** 0.5
    assert palette_distance(one, other) == pytest.approx(expected, rel=0.15)
    assert palette_distance(one, other) == pytest.approx(palette_distance(other, one))
    assert palette_distance(one, other, seed=1) != palette_distance(one, other)
