"""An intensity shows the blend of both renders, where no colour is clamped."""

from dataclasses import replace

import pytest
import torch

from balls import RED, SPLATS, TRAINED
from scenes import layer_towards, randn
from stylesplat.rendering.render import rasterize
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import sh_basis
from stylesplat.verbs.adjust import adjust

EXACT = 1e-5  # colours below 2, sums over some dozen Gaussians in float32


@pytest.fixture
def calm() -> Scene:
    """Painted with colours in the middle of their range, so that none is clamped."""
    scene = replace(TRAINED, base=replace(SPLATS, sh0=SPLATS.sh0 / 2))
    paint = replace(scene.splats, sh0=scene.splats.sh0 + 0.1 * randn(len(SPLATS), 1, 3))
    return scene.with_layers([layer_towards(scene.splats, paint, RED, "red")])


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
