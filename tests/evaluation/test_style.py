"""How close an object is to its style, by the numbers of `stylize` and `evaluate`."""

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
import torch

from balls import CAMERAS, FAST, SPLATS, ball, with_settings
from balls import RED as PICKED
from balls import STRIPED_SCENE as SCENE
from scenes import rand, randn
from stylesplat.evaluation import style
from stylesplat.evaluation.style import (
    LOOK_TOLERANCE,
    content_ssim,
    measure_painted,
    measure_style,
    object_nnfm,
    off_palette,
    own_nnfm,
)
from stylesplat.imaging.color import COLOR_PIXELS
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.scene.layers import Composed
from stylesplat.scene.splats import Splats
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painter import paint_objects, paint_setup
from stylesplat.stylization.painting import Painting
from stylesplat.stylization.views import PaintView, find_boxes

NOISE = rand(48, 48, 3)


def measured(
    jobs: Sequence[Painting],
    network: FeatureNetwork,
    cameras: Cameras = CAMERAS,
    *,
    held_out: Cameras | None = None,
) -> tuple[Composed, dict[str, Any]]:
    studio = paint_setup(SCENE, cameras, network, held_out=held_out)
    styled = paint_objects(studio, jobs)
    surveys = {job.name: find_boxes(SCENE, studio.all_cameras, job.mask) for job in jobs}
    return styled, measure_painted([(studio, job) for job in jobs], styled.splats, surveys)


@pytest.fixture(autouse=True)
def small_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "LOOK_LENGTH", 24.0)


@pytest.fixture(scope="module")
def job(stripes: torch.Tensor) -> Painting:
    return Painting("ball", ball(0), (stripes,), FAST)


@pytest.mark.parametrize(("color", "quality"), [("blend", "draft"), ("free", "normal")])
def test_the_object_comes_closer_to_the_style(
    job: Painting, network: FeatureNetwork, color: str, quality: str
):
    job = with_settings(job, steps=60, color=color, quality=quality)
    styled, metrics = measured([job], network, CAMERAS[1:], held_out=CAMERAS[:1])
    numbers = {name: of["ball"] for name, of in metrics.items() if isinstance(of, dict)}
    assert numbers["nnfm_after"] < 0.97 * numbers["nnfm_before"]
    new = len(styled.splats) - len(SCENE)
    assert (new > 0) == (quality == "normal")
    assert 40 + new <= metrics["changed_gaussians"] <= 80 + new
    assert metrics["outside_max_difference"] < 2e-4, "a canvas hardly shows outside"
    assert numbers["bare"] < 0.01
    assert json.loads(json.dumps(metrics)) == metrics
    before, after = (rasterize(s, CAMERAS)[0] for s in (SCENE, styled.splats))
    assert (before - after).abs().max() > 0.1


def test_what_no_paint_reaches_is_bare(job: Painting, network: FeatureNetwork):
    half = job.mask & (SCENE.means[:, 0] > SCENE.means[job.mask, 0].median())
    colors = SCENE.sh0 + half[:, None, None].float()
    setup = paint_setup(SCENE, CAMERAS, network)
    numbers = measure_style(setup, job, replace(SCENE, sh0=colors))
    assert 0.2 < numbers["bare"] < 0.8
    assert measure_style(setup, job, SCENE)["bare"] == 1


def test_how_near_a_style_is_to_itself(network: FeatureNetwork):
    repeated = NOISE[:8, :8].repeat(6, 6, 1)  # 48 pixels: features of block 2 span 10
    for pictures in ([repeated], [NOISE, NOISE]):
        assert own_nnfm(pictures, network, 2, length=48.0) == pytest.approx(0, abs=1e-6)
    assert (own_nnfm([NOISE], network, 2, length=48.0) or 0) > 0.005, "no place is like another"
    assert own_nnfm([NOISE[:14, :14]], network, 2, length=14.0) is None, "it has one place"


def test_the_background_has_no_say(network: FeatureNetwork):
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(40, 50, 3, generator=generator)
    mask = torch.zeros(20, 25, dtype=torch.bool)
    mask[6, 9] = True
    view = PaintView(CAMERAS[0], mask, torch.ones(40, 50, dtype=torch.bool))
    cells = network.cells(2)
    top, left = (i * cells.stride - cells.before for i in (6, 9))
    inside = torch.zeros(40, 50, 1, dtype=torch.bool)
    inside[top : top + cells.size, left : left + cells.size] = True
    images = [image, image.where(inside, 0.5), image.where(~inside, 0.5)]
    rest = ([view], torch.rand(30, 12, generator=generator), network, 2)
    own, elsewhere, covered = (object_nnfm([each], *rest) for each in images)
    assert own == pytest.approx(elsewhere, abs=1e-6) and covered != pytest.approx(own, abs=1e-6)


# Colours that a style does not have, and the content that an object keeps.


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
    picture = rand(3 * COLOR_PIXELS, 3)
    assert off_palette(picture, picture) == 0
    grey = torch.linspace(0, 1, 256)[:, None].expand(256, 3)
    assert off_palette(torch.tensor([[1.0, 0.0, 0.0]]), grey) == 1


@pytest.mark.parametrize(
    ("away", "expected"), [(LOOK_TOLERANCE - 0.5, 0.0), (LOOK_TOLERANCE + 0.5, 0.25)]
)
def test_what_is_farther_than_10_is_off(away: float, expected: float):
    """L of grey is a third power of what sRGB makes of it."""
    light = torch.tensor([40.0, 40.0 + away])
    grey = ((light + 16) / 116) ** 3
    grey = 1.055 * grey ** (1 / 2.4) - 0.055
    assert (
        off_palette(grey[[0, 0, 0, 1], None].expand(4, 3), grey[:1, None].expand(1, 3)) == expected
    )
