"""What an intensity between 0 and 1 shows: the blend of both renders, but for clamped colours."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from jaxtyping import Bool

from balls import PAINTED_FAST as FAST
from balls import SPLATS, TRAINED, own_rows, painted, write_pictures
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import Splats, sh_basis
from stylesplat.stylization.style import Recipe, Style, StyledObject
from stylesplat.verbs.adjust import adjust
from stylesplat.verbs.evaluate import evaluate
from stylesplat.verbs.stylize import stylize

pytestmark = pytest.mark.usefixtures("quick_painting")

EXACT = 1e-5  # colours below 2, sums over some dozen Gaussians in float32
INTENSITIES = (0.3, 1.5)


def clamped(splats: Splats, camera: Cameras) -> Bool[torch.Tensor, "N 3"]:
    """Which channels of which Gaussians would be negative from there."""
    dirs = torch.nn.functional.normalize(splats.means - camera.positions, dim=1)
    coefficients = torch.cat([splats.sh0, splats.shN], dim=1)
    colors = torch.einsum("nk,nkc->nc", sh_basis(splats.sh_degree, dirs), coefficients) + 0.5
    return colors <= 0


def touched(splats: Splats, camera: Cameras, marked: torch.Tensor) -> Bool[torch.Tensor, "H W D"]:
    """Where something shows of the Gaussians that are marked, for each column of marks."""
    image, _, _ = rasterize(splats, camera, features=marked.float(), sh_degree=0)
    return image[0, ..., 3:] > 0


def blend_error(
    styled: Scene, intensity: float, camera: Cameras
) -> tuple[torch.Tensor, Bool[torch.Tensor, "H W 3"]]:
    """How far from the blend of two renders one is, and where clamped colours are part of it."""
    scenes = [adjust(styled, strength).splats for strength in (0.0, intensity, 1.0)]
    before, found, after = (rasterize(splats, camera)[0][0] for splats in scenes)
    cut = torch.stack([clamped(splats, camera) for splats in scenes]).any(dim=0)
    cut &= own_rows(styled, "red")[:, None]
    error = (torch.lerp(before, after, intensity) - found).abs()
    return error, touched(styled.splats, camera, cut)


@pytest.fixture(scope="module")
def strong(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Colours at the edge of their range, so that many are clamped."""
    return painted(
        TRAINED, "red", write_pictures(tmp_path_factory.mktemp("pictures"))[0], quality="draft"
    )


@pytest.mark.parametrize("intensity", INTENSITIES)
def test_where_no_colour_is_clamped_it_is_the_blend(intensity: float, strong: Scene):
    free, cut = [], []
    for row in range(len(strong.cameras)):
        camera = strong.cameras[row]
        error, with_clamped = blend_error(strong, intensity, camera)
        shown = touched(strong.splats, camera, own_rows(strong, "red")[:, None])
        free.append(error[shown & ~with_clamped])
        cut.append(error[with_clamped])
    assert len(torch.cat(free)) > 50, "of the object"
    assert torch.cat(free).max() < EXACT
    # Measured: 0.01 to 0.40 of a colour's range, in single pixels of this garish style
    assert 0.005 < torch.cat(cut).max() < 0.6


@pytest.fixture(scope="module")
def calm() -> Scene:
    """Colours in the middle of their range."""
    scene = replace(TRAINED, splats=replace(SPLATS, sh0=SPLATS.sh0 / 2))
    picture = 0.45 + 0.1 * torch.rand(64, 80, 3, generator=torch.Generator().manual_seed(0))
    style = Style(picture, steps=3, layers=(1,), object_size=30, lr=0.01, quality="draft")
    return stylize(scene, {"red": style}, device="cpu")


@pytest.mark.parametrize("intensity", INTENSITIES)
def test_of_calm_colours_all_of_the_render_is_the_blend(intensity: float, calm: Scene):
    assert len(calm.splats) == len(SPLATS), "it is painted on its own Gaussians"
    for row in range(len(calm.cameras)):
        error, with_clamped = blend_error(calm, intensity, calm.cameras[row])
        assert not with_clamped.any()
        assert error.max() < EXACT


def test_what_is_measured_is_the_scene_as_it_is_in_the_end(tmp_path: Path):
    style = Style(write_pictures(tmp_path)[0], config=FAST)
    measured = stylize(TRAINED, Recipe((StyledObject("red", style),)), device="cpu").metrics
    assert "red" in measured["nnfm_of_style"] and "red" in measured["nnfm_after"]
    softer = stylize(TRAINED, Recipe((StyledObject("red", style, intensity=0.1),)), device="cpu")
    assert softer.layers[0].strength == 0.1
    loud, soft = measured["share_of_way"]["red"], softer.metrics["share_of_way"]["red"]
    assert abs(soft) < abs(loud)
    numbers = evaluate(softer, device="cpu")
    assert numbers["nnfm_after"] == pytest.approx(softer.metrics["nnfm_after"])
