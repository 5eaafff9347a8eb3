"""An intensity shows the blend of both renders, where no colour is clamped."""

from dataclasses import replace

import pytest
import torch

from balls import SPLATS, TRAINED
from stylesplat.rendering.render import rasterize
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import sh_basis
from stylesplat.stylization.style import Style
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")
EXACT = 1e-5  # colours below 2, sums over some dozen Gaussians in float32


@pytest.fixture(scope="module")
def calm() -> Scene:
    """Painted with colours in the middle of their range, so that none is clamped."""
    scene = replace(TRAINED, splats=replace(SPLATS, sh0=SPLATS.sh0 / 2))
    picture = 0.45 + 0.1 * torch.rand(64, 80, 3, generator=torch.Generator().manual_seed(0))
    style = Style(picture, steps=3, layers=(1,), object_size=30, lr=0.01, quality="draft")
    painted = stylize(scene, {"red": style}, device="cpu", measured=False)
    assert len(painted.splats) == len(SPLATS), "it is painted on its own Gaussians"
    return painted


@pytest.mark.parametrize("intensity", [0.3, 0.6, 1.5])
def test_of_calm_colours_the_render_is_the_blend(intensity: float, calm: Scene):
    scenes = [adjust(calm, strength).splats for strength in (0.0, intensity, 1.0)]
    shown = 0.0
    for camera in calm.cameras:
        for splats in scenes:
            dirs = torch.nn.functional.normalize(splats.means - camera.positions, dim=1)
            coefficients = torch.cat([splats.sh0, splats.shN], dim=1)
            bases = sh_basis(splats.sh_degree, dirs)
            assert torch.einsum("nk,nkc->nc", bases, coefficients).min() > -0.5, "none is clamped"
        before, found, after = (rasterize(splats, camera)[0] for splats in scenes)
        assert (torch.lerp(before, after, intensity) - found).abs().max() < EXACT
        shown = max(shown, float((before - after).abs().max()))
    assert shown > 0.01
