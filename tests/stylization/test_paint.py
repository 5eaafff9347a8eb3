import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS as EIGHT
from balls import FAST, TABLE, TRAINED, ball, enlarged, same, with_settings
from balls import STRIPED_SCENE as SCENE
from scenes import rand
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.weights import coverage
from stylesplat.scene.capture import Capture
from stylesplat.scene.layers import Composed, compose
from stylesplat.scene.splats import Splats, rgb_from_sh0
from stylesplat.stylization.config import STYLE_PRESETS
from stylesplat.stylization.features import FeatureNetwork
from stylesplat.stylization.painter import (
    PREVIEW_STEPS,
    layer_of,
    paint,
    paint_objects,
    paint_setup,
    paint_steps,
)
from stylesplat.stylization.painting import Painting
from stylesplat.stylization.style import Style
from stylesplat.verbs.stylize import stylize

CAMERAS = EIGHT[::2]  # all around


def painted(jobs: Sequence[Painting], network: FeatureNetwork, **options) -> Composed:
    return paint_objects(paint_setup(SCENE, CAMERAS, network, **options), jobs)


def styled_by(job: Painting, network: FeatureNetwork, **settings) -> Splats:
    return painted([with_settings(job, **settings)], network).splats


def picture_error(one: Splats, other: Splats) -> float:
    """PSNR of all views."""
    pairs = [(rasterize(s, CAMERAS)[0] for s in (one, other))]
    return max(float(-10 * (a - b).square().mean().log10()) for a, b in pairs)


@pytest.fixture(scope="module")
def job(stripes: torch.Tensor) -> Painting:
    return Painting("ball", ball(0), (stripes,), FAST)


@pytest.mark.parametrize("quality", ["draft", "normal"])
def test_all_but_the_object_stays_to_the_bit(job: Painting, network: FeatureNetwork, quality: str):
    """Drafts paint the object's own Gaussians, in the shapes that they have, however large."""
    styled, count = painted([with_settings(job, quality=quality)], network), len(SCENE)
    for name, before in SCENE.tensors().items():
        after = styled.splats.tensors()[name][:count]
        assert torch.equal(after[~job.mask], before[~job.mask]), name
        if name in ("sh0", "shN"):
            assert not torch.equal(after, before), name
        elif quality == "draft" or name != "opacities":
            assert torch.equal(after, before), name
    assert same(styled.base, SCENE)
    assert not any(t.requires_grad for t in styled.splats.tensors().values())
    if quality == "draft":
        assert len(styled.splats) == count
        return
    assert count < len(styled.splats) <= count + 16 * job.mask.sum()
    assert job.mask[styled.parents[count:]].all()
    assert not styled.layers[0].surfels.shN.any(), "a canvas is matte"


def test_colors_stay_in_range_where_gradients_exist(job: Painting, network: FeatureNetwork):
    styled = styled_by(job, network, lr=2.0, color="free")
    colors = rgb_from_sh0(styled.sh0[job.mask])
    assert -1e-6 <= colors.min() < 0.01  # a few roundings; and some did go to the limit
    assert 0.99 < colors.max() <= 1 + 1e-6


def test_each_object_is_painted_on_those_before(job: Painting, network: FeatureNetwork):
    """And each with its own settings. The first does not see the second."""
    job = with_settings(job, quality="normal")
    own = replace(FAST, steps=7, color="free", seed=5, quality="normal")
    second = Painting("second", ball(2), (job.images[0].flip(-1),), own)
    both = paint_objects(paint_setup(SCENE, CAMERAS, network), [job, second])
    assert [layer.object for layer in both.layers] == ["ball", "second"]
    first = painted([job], network)
    assert same(compose(SCENE, both.layers[:1]).splats, first.splats)
    studio = paint_setup(first.splats, CAMERAS, network)
    upon = paint_objects(studio, [replace(second, mask=second.mask[first.parents])])
    assert same(upon.splats, both.splats)
    neither = ~(job.mask | second.mask)
    assert same(both.splats[torch.arange(len(SCENE))[neither]], SCENE[neither])


def test_an_object_may_lie_on_the_canvas_of_another(job: Painting, network: FeatureNetwork):
    """What was painted is what is composed, as far as a row may stand for a piece of canvas."""
    job = with_settings(job, quality="normal")
    over = replace(with_settings(job, quality="normal", seed=3), name="over")
    over = replace(over, images=(1 - job.images[0],), mask=ball(0) | ball(1))
    both = painted([job, over], network)
    low, high = both.layers
    assert len(low.surfels) and len(high.surfels)
    assert torch.equal(high.rows, over.mask.nonzero()[:, 0]), "rows of the base alone"
    beneath = compose(SCENE, [low]).splats
    alone = compose(SCENE, [high]).splats
    shown = [rasterize(each, CAMERAS)[0] for each in (both.splats, alone, beneath)]
    assert (shown[0] - shown[1]).abs().mean() < (shown[0] - shown[2]).abs().mean() / 2
    assert same(compose(SCENE, [low, replace(high, strength=0.0)]).splats, beneath)


def test_intensity_blends_renders(job: Painting, network: FeatureNetwork):
    half, full = (painted([with_settings(job, intensity=i)], network) for i in (0.5, 1.0))
    for name in ("sh0", "shN"):
        pair = getattr(SCENE, name), getattr(full.splats, name)
        torch.testing.assert_close(getattr(half.splats, name), sum(pair) / 2)
        assert torch.equal(getattr(half.layers[0], name), getattr(full.layers[0], name))
    nothing = styled_by(job, network, intensity=0.0, quality="normal")
    assert len(nothing) == len(SCENE) and same(nothing, SCENE)


@pytest.mark.parametrize("steps", [1, 3])
def test_the_papers_steps_are_those_of_adam_at_its_rates(
    job: Painting, network: FeatureNetwork, steps: int
):
    """3D Gaussian splatting's code: 0.0025 for the constant band, a twentieth for the others."""
    glaring = SCENE.sh0.clone()
    glaring[job.mask] *= 3  # beyond white and black, where it stays
    scene = replace(SCENE, sh0=glaring)
    paper = replace(STYLE_PRESETS["paper"], steps=steps, block=2, scale=1.5)
    studio = paint_setup(scene, enlarged(CAMERAS, 3), network)
    styled = paint_objects(studio, [replace(job, config=paper)]).splats
    before, after = scene.tensors(), styled.tensors()
    assert {n for n in before if not torch.equal(before[n], after[n])} == {"sh0", "shN"}
    for name, rate in {"sh0": 0.0025, "shN": 0.0025 / 20}.items():
        moved = (after[name] - before[name]).abs().flatten(1)
        assert not moved[~job.mask].any()
        furthest = moved[job.mask].amax(dim=1)
        assert furthest.max() == pytest.approx(steps * rate, rel=0.02)
        if steps == 1:  # Adam's first step has the same length for all that show
            shown = furthest[furthest > 0]
            torch.testing.assert_close(shown, torch.full_like(shown, rate), rtol=1e-2, atol=0)


def test_views_that_do_not_fit_into_memory_give_the_same_picture(
    job: Painting, network: FeatureNetwork
):
    kept, drawn = (
        painted([job], network, max_memory=memory, precision="bfloat16").splats
        for memory in (1.0, 0.0)
    )
    # weights are kept as float16, which may decide between two matches that are as good
    assert picture_error(kept, drawn) > 45
    assert picture_error(kept, SCENE) < 30


def seen_colors(splats: Splats, picked: torch.Tensor) -> torch.Tensor:
    """Where nearly nothing but the object shows."""
    pixels = []
    for index in range(len(CAMERAS)):
        covered = coverage(SCENE, CAMERAS[index], picked) > 0.95
        pixels.append(rasterize(splats, CAMERAS[index])[0][0][covered])
    return torch.cat(pixels)


def test_whose_colors_the_object_has(job: Painting, network: FeatureNetwork):
    own = seen_colors(SCENE, job.mask).mean(dim=0)
    style = job.images[0].reshape(-1, 3)
    ways = {
        color: seen_colors(styled_by(job, network, color=color), job.mask)
        for color in ("style", "keep", "blend")
    }
    # matched where the table shows through too, and before colours are clamped at black
    near = 0.1
    assert (ways["keep"].mean(dim=0) - own).norm() < near
    assert (ways["style"].mean(dim=0) - style.mean(dim=0)).norm() < 2.5 * near
    assert (ways["blend"].mean(dim=0) - (own + style.mean(dim=0)) / 2).norm() < 1.2 * near
    assert (own - style.mean(dim=0)).norm() > 4 * near
    spread, wanted = ways["style"].T.cov(), style.T.cov()
    # what the closed form spreads beyond three colours is led back to near them
    assert (spread - wanted).norm() < 0.6 * wanted.norm()


def test_features_take_the_best_match_of_several_pictures(job: Painting, network: FeatureNetwork):
    noise = rand(44, 52, 3)
    both = painted([replace(job, images=(*job.images, noise))], network)
    twice = painted([replace(job, images=job.images * 2)], network)
    single = styled_by(job, network)
    assert picture_error(twice.splats, single) > picture_error(both.splats, single) + 3


def test_the_verb(job: Painting, network: FeatureNetwork, tmp_path: Path):
    path = tmp_path / "style.png"
    pixels = (job.images[0] * 255).round().to(torch.uint8)
    Image.fromarray(pixels.numpy()).save(path)
    photos = [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS)
    rest = {"config": FAST, "network": network}
    by_file = paint(SCENE, Capture(CAMERAS, photos), job.mask, path, **rest)
    by_pixels = paint(SCENE, CAMERAS, job.mask, pixels / 255, **rest)
    assert same(by_file, by_pixels)
    with pytest.raises(StyleSplatError, match="There is no image"):
        paint(SCENE, CAMERAS, job.mask, tmp_path / "none.png", **rest)


def test_states_lead_to_the_same(job: Painting, network: FeatureNetwork):
    job = with_settings(job, quality="normal")
    context = paint_setup(SCENE, CAMERAS, network)
    live = paint_steps(context, job, preview=True)
    early = list(islice(live, 5))
    assert [state.step for state in early] == [1, 2, 3, 4, 5]
    kept = early[-1].splats.sh0.clone()
    late = list(live)  # goes on
    total = early[0].steps
    assert 12 < total <= 12 + PREVIEW_STEPS
    assert [state.step for state in late] == list(range(6, total + 1))
    assert all(state.steps == total and math.isfinite(state.nnfm) for state in early + late)
    layer = layer_of(late[-1], job)
    assert same(compose(SCENE, [layer]).splats, painted([job], network).splats)
    assert torch.equal(early[-1].splats.sh0, kept), "later steps leave earlier states alone"
    assert not torch.equal(early[-2].splats.sh0, kept)
    assert len(early[0].splats) == len(early[0].canvas.parents) == len(SCENE), (
        "the preview comes first"
    )
    assert len(late[-1].splats) == len(late[-1].canvas.parents) > len(SCENE)
    assert early[0].canvas.before is context.splats
    again = next(paint_steps(context, job, preview=True))
    assert same(again.splats, early[0].splats), "who starts again gets the same"
    other = next(paint_steps(context, with_settings(job, seed=1), preview=True))
    assert not same(other.splats, early[0].splats)


HIDDEN = replace(SCENE, opacities=torch.where(ball(0), -20.0, SCENE.opacities))
HAZE = replace(  # half-covered pixels are there, but none is painted by one Gaussian for the most
    SCENE,
    opacities=torch.where(ball(0), -4.4, SCENE.opacities),
    scales=torch.where(ball(0)[:, None], math.log(0.5), SCENE.scales),
)
FEW = ball(0) & (torch.arange(len(SCENE)) < TABLE + 49)


def test_what_cannot_be_painted_is_refused(job: Painting, network: FeatureNetwork):
    for splats, jobs, fault in (
        (HIDDEN, [job], "ball: it is seen in none of the 4 views"),
        (HAZE, [job], "ball: most of what each"),
        (SCENE, [with_settings(job, object_size=4, scale=50.0)], "ball: it is hardly visible"),
        (SCENE, [replace(job, mask=FEW)], "ball: it has 49 Gaussians"),
        (SCENE, [job, replace(job, mask=ball(1))], "ball was given twice"),
        (SCENE, [], "Nothing to stylise"),
    ):
        with pytest.raises(StyleSplatError, match=fault):
            paint_objects(paint_setup(splats, CAMERAS, network), jobs)
    with pytest.raises(StyleSplatError, match="Cannot keep views in -1"):
        painted([job], network, max_memory=-1.0)


def test_few_steps_take_a_view_that_shows_the_object(network: FeatureNetwork, job: Painting):
    """Two steps take the view in the middle, from which the ball is too small to be painted."""
    viewmats = CAMERAS.viewmats.clone()
    viewmats[len(CAMERAS) // 2, 2, 3] += 12
    cameras = replace(CAMERAS, viewmats=viewmats)
    styled = paint_objects(paint_setup(SCENE, cameras, network), [with_settings(job, steps=2)])
    assert not torch.equal(styled.splats.sh0[: len(SCENE)], SCENE.sh0)


def test_a_viewer_may_paint_without_gradients(job: Painting, network: FeatureNetwork):
    with torch.no_grad():
        quiet = styled_by(job, network)
    assert same(quiet, styled_by(job, network))


def test_no_object_is_painted_if_another_cannot_be(monkeypatch: pytest.MonkeyPatch):
    def no_step(*_: object) -> None:
        raise AssertionError("an object was painted")

    monkeypatch.setattr("stylesplat.stylization.painter.optimize_colors", no_step)
    picture = torch.rand(64, 64, 3)
    styles = {"red": picture, "green": Style(picture, object_size=4, scale=50.0)}
    with pytest.raises(StyleSplatError, match="green: it is hardly visible"):
        stylize(TRAINED, styles, device="cpu")


def test_a_style_smaller_than_a_feature_is_painted(job: Painting, network: FeatureNetwork):
    small = with_settings(job, object_size=24, scale=0.1, steps=4)
    styled = painted([small], network)
    assert not torch.equal(styled.splats.sh0[: len(SCENE)], SCENE.sh0)


def test_a_style_of_one_color_gives_its_color(job: Painting, network: FeatureNetwork):
    green = torch.tensor([0.1, 0.5, 0.2]).expand(64, 64, 3)
    splats = painted([replace(job, images=(green,))], network).splats
    image = rasterize(splats, CAMERAS[:1])[0]
    own = coverage(SCENE, CAMERAS[0], job.mask) > 0.9
    mean = image[0][own].mean(dim=0)
    torch.testing.assert_close(mean, green[0, 0], atol=0.1, rtol=0)


def test_soft_picks_leave_what_is_not_the_object(job: Painting, network: FeatureNetwork):
    """A picked Gaussian that hangs beside the ball, large and faint, keeps every bit."""
    means, scales, opacities = (t.clone() for t in (SCENE.means, SCENE.scales, SCENE.opacities))
    means[0] += torch.tensor([0.0, 0.0, 0.5])
    scales[0], opacities[0] = math.log(0.5), -2.0
    scene = replace(SCENE, means=means, scales=scales, opacities=opacities)
    hazy = replace(job, mask=job.mask.index_fill(0, torch.tensor([0]), True))
    studio = paint_setup(scene, CAMERAS, network)
    first = torch.tensor([0])
    for quality in ("draft", "normal"):
        styled = paint_objects(studio, [with_settings(hazy, quality=quality)])
        assert same(styled.splats[first], scene[first])
        rest = (~hazy.mask).nonzero()[:, 0]
        assert same(styled.splats[rest], scene[rest])
    published = paint_objects(studio, [with_settings(hazy, published=True, quality="normal")])
    assert not torch.equal(published.splats.sh0[:1], scene.sh0[:1]), "the paper paints every pick"
