"""Splats with numbers at the bounds of what is read can be used."""

from dataclasses import replace

import pytest
import torch

from balls import CAMERAS, SPLATS
from stylesplat.io.tensors import GAUSSIANS
from stylesplat.rendering.render import rasterize
from stylesplat.scene.scene import Scene
from stylesplat.selection.labels import inliers
from stylesplat.verbs.select import select


@pytest.mark.parametrize("field", ["means", "quats", "scales", "opacities", "sh0"])
@pytest.mark.parametrize("end", ["low", "high"])
def test_splats_that_are_at_the_bounds_can_be_used(field: str, end: str):
    values = getattr(SPLATS, field).clone()
    values[::2] = getattr(GAUSSIANS[field], end)
    splats = replace(SPLATS, **{field: values})
    image, alphas, _ = rasterize(splats, CAMERAS[0])
    assert image.isfinite().all() and alphas.isfinite().all()
    assert inliers(splats.means).any()
    found = select(Scene(splats, CAMERAS), "vase", id=3)
    assert torch.equal(found.splats.means, splats.means) and found.objects["vase"].mask.any()
