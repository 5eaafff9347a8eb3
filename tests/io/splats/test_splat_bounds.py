"""Numbers that no splat has are refused as they are read; what is at the bounds can be used."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from balls import CAMERAS, SPLATS
from scenes import plain_scene
from stylesplat.errors import StyleSplatError
from stylesplat.io.splats.splat_files import read_splats, write_splats
from stylesplat.io.tensors import GAUSSIANS
from stylesplat.rendering.render import rasterize
from stylesplat.scene.scene import Scene
from stylesplat.selection.members import inliers
from stylesplat.verbs.select import select


@pytest.mark.parametrize("suffix", ["ply", "splat"])
@pytest.mark.parametrize(("field", "value"), [("means", 1e38), ("scales", 80.0)])
def test_numbers_of_no_splat_are_refused(field: str, value: float, suffix: str, tmp_path: Path):
    splats = plain_scene().splats
    values = getattr(splats, field).clone()
    values[0] = value
    path = tmp_path / f"a.{suffix}"
    write_splats(replace(splats, **{field: values}), path)
    with pytest.raises(StyleSplatError, match=f"of {field} are out of range"):
        read_splats(path)


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
    assert torch.equal(found.splats.means, splats.means) and found.objects["vase"].picked.any()
