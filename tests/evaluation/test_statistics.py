"""Colours that a style does not have, and the content that an object keeps."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from balls import RED as PICKED
from scenes import rand, randn
from stylesplat.evaluation.statistics import TOLERANCE, content_ssim, off_palette
from stylesplat.metrics.lab import PIXELS
from stylesplat.scene.splats import Splats


def repainted(mask: torch.Tensor) -> Splats:
    """The scene with other colours of some Gaussians."""
    noise = randn(*SPLATS.sh0.shape)
    return replace(SPLATS, sh0=SPLATS.sh0 + noise * mask[:, None, None])


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


def test_a_picture_is_on_its_own_palette():
    picture = rand(3 * PIXELS, 3)
    assert off_palette(picture, picture) == 0
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
