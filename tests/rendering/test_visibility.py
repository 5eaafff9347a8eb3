"""What one camera sees: the same whether the scene is looked through at once or in parts."""

from dataclasses import replace

import pytest
import torch

from scenes import joined, random_splats, two_cameras
from stylesplat.rendering import render as rendering
from stylesplat.rendering import visibility
from stylesplat.rendering.reference import activated
from stylesplat.rendering.render import rasterize, render, render_row_bands
from stylesplat.rendering.visibility import in_view, visible
from stylesplat.scene.splats import Splats

CAMERA = two_cameras()[0]
SPLATS = random_splats(1000)
ROUNDING = 1e-6  # exponents of scales differ in the last bit by the place in a tensor


@pytest.fixture(params=[1 << 17, 64], ids=["at once", "in parts"])
def part(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """How many Gaussians are looked at together."""
    monkeypatch.setattr(visibility, "PART", request.param)
    monkeypatch.setattr(rendering, "PART", request.param)


def walled() -> Splats:
    """The cloud behind a wall that nothing shows through, but for what is nearer."""
    wall = replace(random_splats(1), means=torch.tensor([[0.0, 0.0, -1.0]]))
    wall = replace(wall, scales=torch.full((1, 3), 4.0), opacities=torch.full((1,), 20.0))
    return joined(wall, wall, wall, SPLATS)  # one lets a thousandth through


@pytest.mark.usefixtures("part")
@pytest.mark.parametrize("degree", [None, 0, 1])
def test_renders_are_those_with_gradients(degree: int | None):
    background = torch.tensor([0.2, 0.4, 0.6])
    options = {"features": SPLATS.identities, "background": background, "sh_degree": degree}
    images, alphas, _ = rasterize(SPLATS, CAMERA, **options)
    image, coverage = render(SPLATS, CAMERA, **options)
    torch.testing.assert_close(image, images[0], atol=ROUNDING, rtol=ROUNDING)
    torch.testing.assert_close(coverage, alphas[0], atol=ROUNDING, rtol=ROUNDING)


@pytest.mark.parametrize("height", [16, 20, 1000])
def test_bands_are_the_picture_from_the_middle_on(height: int):
    background = torch.tensor([0.2, 0.4, 0.6])
    image, _ = render(SPLATS, CAMERA, background=background)
    bands = dict(render_row_bands(SPLATS, CAMERA, background=background, height=height))
    joined_bands = torch.cat([band for _, band in sorted(bands.items())])
    torch.testing.assert_close(joined_bands, image, atol=1e-5, rtol=0)  # places are rounded anew
    middle = len(image) / 2
    far = [abs(top + height / 2 - middle) for top in bands]
    assert far == sorted(far)


@pytest.mark.usefixtures("part")
@pytest.mark.parametrize("antialiased", [False, True])
def test_what_is_seen_is_what_has_a_radius(antialiased: bool):
    splats = replace(SPLATS, scales=SPLATS.scales - 2, antialiased=antialiased)
    image, _, info = rasterize(splats, CAMERA)
    torch.testing.assert_close(render(splats, CAMERA)[0], image[0], atol=ROUNDING, rtol=ROUNDING)
    found = in_view(splats, CAMERA)
    there = (info["radii"][0] > 0).all(dim=1)
    assert torch.equal(found.rows, there.nonzero()[:, 0]) and not there.all()
    means2d = info["means2d"][0, there]
    torch.testing.assert_close(found.projected.means2d, means2d, atol=1e-4, rtol=0)
    opacities = (
        activated(splats).opacities[there] if not antialiased else info["opacities"][0, there]
    )
    torch.testing.assert_close(found.projected.opacities, opacities, atol=ROUNDING, rtol=0)


@pytest.mark.usefixtures("part")
def test_what_is_hidden_is_not_visible():
    splats, camera = walled(), CAMERA.crop((0, 0), (64, 48))  # tiles that lie in the image
    rows = visible(in_view(splats, camera), camera).rows
    assert torch.equal(rows, rows.unique()) and rows[0] == 0
    behind = splats.means[:, 2] > 0
    assert behind[in_view(splats, camera).rows].any() and not behind[rows].any()


@pytest.mark.usefixtures("part")
def test_of_some_pixels_only_what_reaches_them():
    pixels = torch.zeros(52, 70, dtype=torch.bool)
    pixels[:10, :20] = True
    few, every = in_view(SPLATS, CAMERA, pixels), in_view(SPLATS, CAMERA)
    assert 0 < len(few.rows) < len(every.rows)
    whole, part = render(SPLATS, CAMERA)[0], render(SPLATS[few.rows], CAMERA)[0]
    torch.testing.assert_close(part[pixels], whole[pixels], atol=ROUNDING, rtol=0)


def test_of_many_features_are_gathered_where_they_show(monkeypatch: pytest.MonkeyPatch):
    splats = walled()
    whole = render(splats, CAMERA, features=splats.identities)
    monkeypatch.setattr(rendering, "VISIBLE_MANY", 0)
    image, alphas = render(splats, CAMERA, features=splats.identities)
    assert torch.equal(image, whole[0]) and torch.equal(alphas, whole[1])


@pytest.mark.parametrize("count", [0, 1])
def test_a_camera_that_sees_nothing(count: int):
    splats = replace(random_splats(count), opacities=torch.full((count,), -20.0))
    image, alphas = render(splats, CAMERA)
    assert image.shape == (52, 70, 3) and not image.any() and not alphas.any()
    assert not len(visible(in_view(splats, CAMERA), CAMERA).rows)
