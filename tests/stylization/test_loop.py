import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS, SPLATS
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.rasterize import rasterize
from stylesplat.rendering.sh import rgb_from_sh0
from stylesplat.scene.capture import Capture
from stylesplat.scene.splats import Splats
from stylesplat.stylization import loop
from stylesplat.stylization.config import StyleConfig
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.loop import StyleJob, stylize, stylize_objects

FAST = StyleConfig(steps=12, blocks=(2,), scale=1.5, object_size=24, style_samples=200)
BANDS = 0.1 * torch.randn(len(SPLATS), 3, 3, generator=torch.Generator().manual_seed(0))
SCENE = replace(SPLATS, shN=BANDS)
TABLE = 200  # Gaussians before the balls' 80 each


def ball(number: int) -> torch.Tensor:
    picked = torch.zeros(len(SCENE), dtype=torch.bool)
    picked[TABLE + 80 * number : TABLE + 80 * (number + 1)] = True
    return picked


def changed(styled: Splats) -> set[str]:
    before, after = SCENE.tensors(), styled.tensors()
    return {name for name in before if not torch.equal(before[name], after[name])}


@pytest.fixture(autouse=True)
def small_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "MEASURED_LENGTH", 24.0)


@pytest.fixture(scope="module")
def job(stripes: torch.Tensor) -> StyleJob:
    return StyleJob("ball", ball(0), stripes)


@pytest.mark.parametrize("view_dependent", [False, True])
def test_only_colors_of_the_picked_change(
    job: StyleJob, network: FeatureNetwork, view_dependent: bool
):
    config = replace(FAST, view_dependent=view_dependent, color_transfer=False)
    styled, metrics = stylize_objects(SCENE, CAMERAS, [job], network, config)
    assert changed(styled) == ({"sh0", "shN"} if view_dependent else {"sh0"})
    assert torch.equal(styled.sh0[~job.picked], SCENE.sh0[~job.picked])
    assert torch.equal(styled.shN[~job.picked], SCENE.shN[~job.picked])
    assert metrics["changed_gaussians"] <= 80
    assert (metrics["outside_psnr"], metrics["outside_max_difference"]) == (120, 0)
    assert not any(t.requires_grad for t in styled.tensors().values())


@pytest.mark.parametrize("color_transfer", [False, True])
def test_the_object_comes_closer_to_the_style(
    job: StyleJob, network: FeatureNetwork, color_transfer: bool
):
    config = replace(FAST, steps=40, color_transfer=color_transfer)
    styled, metrics = stylize_objects(
        SCENE, CAMERAS[1:], [job], network, config, held_out=CAMERAS[:1]
    )
    measured = metrics["objects"]["ball"]
    assert measured["nnfm_after"] < 0.9 * measured["nnfm_before"]
    assert (measured["steps"], measured["views"], measured["gaussians"]) == (40, 7, 80)
    assert json.loads(json.dumps(metrics)) == metrics
    before, after = (rasterize(s, CAMERAS)[0] for s in (SCENE, styled))
    assert (before - after).abs().max() > 0.1


def test_colors_start_where_they_were(job: StyleJob, network: FeatureNetwork):
    config = replace(FAST, steps=2, lr=1e-6, view_dependent=True, color_transfer=False)
    styled, _ = stylize_objects(SCENE, CAMERAS, [job], network, config)
    torch.testing.assert_close(styled.sh0, SCENE.sh0, atol=1e-5, rtol=0)
    torch.testing.assert_close(styled.shN, SCENE.shN, atol=1e-5, rtol=0)


def test_colors_stay_in_range_where_gradients_exist(job: StyleJob, network: FeatureNetwork):
    styled, _ = stylize_objects(SCENE, CAMERAS, [job], network, replace(FAST, lr=2.0, final_lr=1.0))
    colors = rgb_from_sh0(styled.sh0[job.picked])
    assert -1e-6 <= colors.min() < 0.01  # a few roundings; and some did go to the limit
    assert 0.99 < colors.max() <= 1 + 1e-6


def test_the_rate_decays(job: StyleJob, network: FeatureNetwork):
    """With Adam's steps of about one rate each, the sum of the rates bounds the way."""
    config = replace(FAST, lr=0.1, final_lr=1e-6, color_transfer=False)
    styled, _ = stylize_objects(SCENE, CAMERAS, [job], network, config)
    rates = [0.1 * 1e-6 ** (step / config.steps) for step in range(config.steps)]
    assert (styled.sh0 - SCENE.sh0).abs().max() < 1.5 * sum(rates) < 0.5 * 0.1 * config.steps


def test_seeds_reproduce(job: StyleJob, network: FeatureNetwork):
    one, same, other = (
        stylize_objects(SCENE, CAMERAS, [job], network, replace(FAST, seed=seed))[0]
        for seed in (0, 0, 1)
    )
    assert torch.equal(one.sh0, same.sh0)
    assert not torch.equal(one.sh0, other.sh0)


def test_each_object_is_styled_by_itself(job: StyleJob, network: FeatureNetwork):
    second = StyleJob("second", ball(2), job.style.flip(-1))
    both, metrics = stylize_objects(SCENE, CAMERAS, [job, second], network, FAST)
    swapped, _ = stylize_objects(SCENE, CAMERAS, [second, job], network, FAST)
    alone, _ = stylize_objects(SCENE, CAMERAS, [job], network, FAST)
    assert torch.equal(both.sh0, swapped.sh0)
    assert torch.equal(both.sh0[job.picked], alone.sh0[job.picked])
    assert torch.equal(alone.sh0[second.picked], SCENE.sh0[second.picked])
    assert set(metrics["objects"]) == {"ball", "second"}
    assert metrics["steps"] == 2 * FAST.steps


def test_intensity_blends_renders(job: StyleJob, network: FeatureNetwork):
    none, half, full = (
        stylize_objects(SCENE, CAMERAS, [job], network, replace(FAST, intensity=i))[0]
        for i in (0.0, 0.5, 1.0)
    )
    assert changed(none) == set()
    for name in ("sh0", "shN"):
        mean = (getattr(SCENE, name) + getattr(full, name)) / 2
        torch.testing.assert_close(getattr(half, name), mean)


def test_the_verb(job: StyleJob, network: FeatureNetwork, tmp_path: Path):
    path = tmp_path / "style.png"
    pixels = (job.style * 255).round().to(torch.uint8)
    Image.fromarray(pixels.numpy()).save(path)
    photos = [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS)
    by_file = stylize(
        SCENE, Capture(CAMERAS, photos), job.picked, path, config=FAST, network=network
    )
    by_pixels = stylize(SCENE, CAMERAS, job.picked, pixels / 255, config=FAST, network=network)
    assert torch.equal(by_file.sh0, by_pixels.sh0)
    with pytest.raises(StyleSplatError, match="There is no image"):
        stylize(SCENE, CAMERAS, job.picked, tmp_path / "none.png", config=FAST, network=network)


def test_unseen_objects(job: StyleJob, network: FeatureNetwork):
    faint = replace(SCENE, opacities=torch.where(job.picked, -20.0, SCENE.opacities))
    with pytest.raises(StyleSplatError, match="ball: it is seen in none of the 8 views"):
        stylize_objects(faint, CAMERAS, [job], network, FAST)
    with pytest.raises(StyleSplatError, match="ball: it is hardly visible"):
        stylize_objects(SCENE, CAMERAS, [job], network, replace(FAST, object_size=4))


def test_too_few_gaussians(job: StyleJob, network: FeatureNetwork):
    few = replace(job, picked=job.picked & (torch.arange(len(SCENE)) < TABLE + 49))
    with pytest.raises(StyleSplatError, match="ball: it has 49 Gaussians"):
        stylize_objects(SCENE, CAMERAS, [few], network, FAST)


def test_jobs_that_clash(job: StyleJob, network: FeatureNetwork):
    wide = StyleJob("wide", ball(0) | ball(1), job.style)
    with pytest.raises(StyleSplatError, match="ball and wide at once: they share 80 Gaussians"):
        stylize_objects(SCENE, CAMERAS, [job, wide], network, FAST)
    with pytest.raises(StyleSplatError, match="ball was given two styles"):
        stylize_objects(SCENE, CAMERAS, [job, replace(job, picked=ball(1))], network, FAST)
    with pytest.raises(StyleSplatError, match="Nothing to stylise"):
        stylize_objects(SCENE, CAMERAS, [], network, FAST)


def test_small_styles(job: StyleJob, network: FeatureNetwork):
    small = replace(job, style=torch.rand(8, 90, 3))
    with pytest.raises(StyleSplatError, match="it is 90x8 pixels"):
        stylize_objects(SCENE, CAMERAS, [small], network, FAST)
