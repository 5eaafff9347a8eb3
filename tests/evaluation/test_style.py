"""How close an object is to its style, by the numbers of `stylize` and `evaluate`."""

import json
from collections.abc import Sequence
from typing import Any

import pytest
import torch

from balls import CAMERAS, FAST, ball, with_settings
from balls import STRIPED_SCENE as SCENE
from scenes import rand
from stylesplat.evaluation import style
from stylesplat.evaluation.style import measure_painted, object_nnfm, own_nnfm
from stylesplat.rendering.render import rasterize
from stylesplat.scene.cameras import Cameras
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.paint import Painted, paint_context, paint_objects
from stylesplat.stylization.target import PaintTarget
from stylesplat.stylization.views import ObjectView

NOISE = rand(48, 48, 3)


def measured(
    jobs: Sequence[PaintTarget],
    network: FeatureNetwork,
    cameras: Cameras = CAMERAS,
    *,
    held_out: Cameras | None = None,
) -> tuple[Painted, dict[str, Any]]:
    studio = paint_context(SCENE, cameras, network, held_out=held_out)
    styled = paint_objects(studio, jobs)
    return styled, measure_painted([studio] * len(jobs), jobs, styled.splats, held_out=held_out)


@pytest.fixture(autouse=True)
def small_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(style, "LENGTH", 24.0)


@pytest.fixture(scope="module")
def job(stripes: torch.Tensor) -> PaintTarget:
    return PaintTarget("ball", ball(0), (stripes,), FAST)


@pytest.mark.parametrize(("color", "quality"), [("blend", "draft"), ("free", "normal")])
def test_the_object_comes_closer_to_the_style(
    job: PaintTarget, network: FeatureNetwork, color: str, quality: str
):
    job = with_settings(job, steps=60, color=color, quality=quality)
    styled, metrics = measured([job], network, CAMERAS[1:], held_out=CAMERAS[:1])
    numbers = metrics["objects"]["ball"]
    assert numbers["nnfm_after"] < 0.97 * numbers["nnfm_before"]
    new = len(styled.splats) - len(SCENE)
    assert (new > 0) == (quality == "normal")
    assert 40 + new <= metrics["changed_gaussians"] <= 80 + new
    assert metrics["outside_max_difference"] < 2e-4, "a canvas hardly shows outside"
    assert json.loads(json.dumps(metrics)) == metrics
    before, after = (rasterize(s, CAMERAS)[0] for s in (SCENE, styled.splats))
    assert (before - after).abs().max() > 0.1


def test_how_near_a_style_is_to_itself(network: FeatureNetwork):
    repeated = NOISE[:8, :8].repeat(6, 6, 1)  # 48 pixels: features of block 2 span 10
    for pictures in ([repeated], [NOISE, NOISE]):
        assert own_nnfm(pictures, network, (2,), length=48.0) == pytest.approx(0, abs=1e-6)
    assert (own_nnfm([NOISE], network, (2,), length=48.0) or 0) > 0.005, "no place is like another"
    assert own_nnfm([NOISE[:14, :14]], network, (2,), length=14.0) is None, "it has one place"


def test_the_background_has_no_say(network: FeatureNetwork):
    generator = torch.Generator().manual_seed(0)
    image = torch.rand(40, 50, 3, generator=generator)
    mask = torch.zeros(20, 25, dtype=torch.bool)
    mask[6, 9] = True
    view = ObjectView(CAMERAS[0], (mask,), torch.ones(40, 50, dtype=torch.bool))
    cells = network.cells(2)
    top, left = (i * cells.stride - cells.before for i in (6, 9))
    inside = torch.zeros(40, 50, 1, dtype=torch.bool)
    inside[top : top + cells.size, left : left + cells.size] = True
    images = [image, image.where(inside, 0.5), image.where(~inside, 0.5)]
    rest = ([view], [torch.rand(30, 12, generator=generator)], network, [2])
    own, elsewhere, covered = (object_nnfm([each], *rest) for each in images)
    assert own == pytest.approx(elsewhere, abs=1e-6) and covered != pytest.approx(own, abs=1e-6)
