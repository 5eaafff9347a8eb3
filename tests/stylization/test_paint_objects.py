import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest
import torch
from PIL import Image

from balls import CAMERAS, enlarged
from striped_balls import FAST, GROWN, SCENE, TABLE, ball, same, with_settings
from stylesplat.errors import StyleSplatError
from stylesplat.rendering.render import rasterize
from stylesplat.rendering.sh import rgb_from_sh0
from stylesplat.rendering.shares import coverage
from stylesplat.scene.capture import Capture
from stylesplat.scene.compose import compose
from stylesplat.scene.splats import Splats
from stylesplat.selection.soft_picks import find_places, soft_shares
from stylesplat.stylization.features.network import FeatureNetwork
from stylesplat.stylization.paint_objects import (
    Styled,
    open_studio,
    paint,
    paint_live,
    paint_objects,
)
from stylesplat.stylization.style_config import PRESETS, Precision
from stylesplat.stylization.style_job import StyleJob


def changed(styled: Splats) -> set[str]:
    before, after = SCENE.tensors(), styled.tensors()
    return {name for name in before if not torch.equal(before[name], after[name])}


def painted(jobs: Sequence[StyleJob], network: FeatureNetwork, **options) -> Styled:
    return paint_objects(open_studio(SCENE, CAMERAS, network, **options), jobs)[0]


def styled_by(job: StyleJob, network: FeatureNetwork, **settings) -> Splats:
    return painted([with_settings(job, **settings)], network).splats


def picture_error(one: Splats, other: Splats) -> float:
    """PSNR of all views."""
    pairs = [(rasterize(s, CAMERAS)[0] for s in (one, other))]
    return max(float(-10 * (a - b).square().mean().log10()) for a, b in pairs)


@pytest.fixture(scope="module")
def job(stripes: torch.Tensor) -> StyleJob:
    return StyleJob("ball", ball(0), (stripes,), FAST)


@pytest.mark.parametrize("mode", ["drop", "keep", "train"])
def test_only_colors_of_the_picked_change(job: StyleJob, network: FeatureNetwork, mode: str):
    job = with_settings(job, view_dependence=mode, color="free", hard=True)
    styled = painted([job], network)
    splats = styled.splats
    assert changed(splats) == ({"sh0"} if mode == "keep" else {"sh0", "shN"})
    assert torch.equal(splats.sh0[~job.picked], SCENE.sh0[~job.picked])
    assert torch.equal(splats.shN[~job.picked], SCENE.shN[~job.picked])
    assert splats.shN[job.picked].any() == (mode != "drop")
    assert same(styled.base, SCENE)
    assert not any(t.requires_grad for t in splats.tensors().values())


def test_own_gaussians_keep_their_places_and_shapes(job: StyleJob, network: FeatureNetwork):
    """However large they are: new ones are those of a canvas."""
    job = with_settings(job, max_growth=1.0)
    styled = painted([job], network)
    assert len(styled.splats) == len(SCENE)
    for name, before in SCENE.tensors().items():
        after = styled.splats.tensors()[name]
        assert torch.equal(after[~job.picked], before[~job.picked]), name
        assert torch.equal(after, before) == (name not in ("sh0", "shN")), name


def test_the_rest_is_the_same_to_the_bit_beside_a_canvas(job: StyleJob, network: FeatureNetwork):
    styled = painted([with_settings(job, max_growth=GROWN)], network)
    count = len(SCENE)
    assert count < len(styled.splats) <= count + (GROWN - 1) * job.picked.sum()
    for name, before in SCENE.tensors().items():
        after = styled.splats.tensors()[name][:count]
        assert torch.equal(after[~job.picked], before[~job.picked]), name
        if name not in ("sh0", "shN", "opacities"):
            assert torch.equal(after, before), name
    assert job.picked[styled.parents[count:]].all()
    assert not styled.layers[0].canvas.shN.any(), "a canvas is matte"


def test_colors_start_where_they_were(job: StyleJob, network: FeatureNetwork):
    settings = {"steps": 2, "lr": 1e-6, "view_dependence": "train", "color": "free"}
    styled = styled_by(job, network, **settings)
    torch.testing.assert_close(styled.sh0, SCENE.sh0, atol=1e-5, rtol=0)
    torch.testing.assert_close(styled.shN, SCENE.shN, atol=1e-5, rtol=0)


def test_the_own_pattern_is_gone_before_the_first_step(job: StyleJob, network: FeatureNetwork):
    """As much of it as content is not kept; the constant bands of a ball are all the same."""
    settings = {"steps": 2, "lr": 1e-9, "view_dependence": "train"}
    none, half, full = (
        styled_by(job, network, content=content, **settings).shN[job.picked].std()
        for content in (0.0, 0.5, 1.0)
    )
    assert none < half < full


def test_colors_stay_in_range_where_gradients_exist(job: StyleJob, network: FeatureNetwork):
    styled = styled_by(job, network, lr=2.0, final_lr=1.0, color="free")
    colors = rgb_from_sh0(styled.sh0[job.picked])
    assert -1e-6 <= colors.min() < 0.01  # a few roundings; and some did go to the limit
    assert 0.99 < colors.max() <= 1 + 1e-6


def test_the_rate_decays(job: StyleJob, network: FeatureNetwork):
    """With Adam's steps of about one rate each, the sum of the rates bounds the way."""
    styled = styled_by(job, network, lr=0.1, final_lr=1e-6, color="free", steps=4, quality="draft")
    # one stage of three steps and one of one, each decays
    rates = [0.1 * 1e-6 ** (step / 3) for step in range(3)] + [0.1]
    assert (styled.sh0 - SCENE.sh0).abs().max() < 1.5 * sum(rates) < 0.8 * 0.1 * 4


def test_seeds_reproduce(job: StyleJob, network: FeatureNetwork):
    job = with_settings(job, max_growth=GROWN)
    one, again, other = (styled_by(job, network, seed=seed) for seed in (0, 0, 1))
    assert same(one, again)
    assert not torch.equal(one.sh0, other.sh0)


def test_each_object_is_painted_on_those_before(job: StyleJob, network: FeatureNetwork):
    """And each with its own settings. The first does not see the second."""
    job = with_settings(job, max_growth=GROWN)
    own = replace(FAST, steps=7, color="free", view_dependence="keep", seed=5, max_growth=1.5)
    second = StyleJob("second", ball(2), (job.styles[0].flip(-1),), own)
    both, seconds = paint_objects(open_studio(SCENE, CAMERAS, network), [job, second])
    assert [layer.object for layer in both.layers] == ["ball", "second"]
    first = painted([job], network)
    assert same(compose(SCENE, both.layers[:1]), first.splats)
    studio = open_studio(first.splats, CAMERAS, network)
    upon, _ = paint_objects(studio, [replace(second, picked=second.picked[first.parents])])
    assert same(upon.splats, both.splats)
    neither = ~(job.picked | second.picked)
    assert same(both.splats[torch.arange(len(SCENE))[neither]], SCENE[neither])
    assert list(seconds) == ["ball", "second"] and all(taken > 0 for taken in seconds.values())


def test_an_object_may_lie_on_the_canvas_of_another(job: StyleJob, network: FeatureNetwork):
    """What was painted is what is composed, as far as a row may stand for a piece of canvas."""
    job = with_settings(job, max_growth=GROWN)
    over = replace(with_settings(job, max_growth=GROWN, seed=3), name="over")
    over = replace(over, styles=(1 - job.styles[0],), picked=ball(0) | ball(1))
    both = painted([job, over], network)
    low, high = both.layers
    assert len(low.canvas) and len(high.canvas)
    assert torch.equal(high.rows, over.picked.nonzero()[:, 0]), "rows of the base alone"
    beneath = compose(SCENE, [low])
    alone = compose(SCENE, [high])
    shown = [rasterize(each, CAMERAS)[0] for each in (both.splats, alone, beneath)]
    assert (shown[0] - shown[1]).abs().mean() < (shown[0] - shown[2]).abs().mean() / 2
    assert same(compose(SCENE, [low, replace(high, strength=0.0)]), beneath)


def test_intensity_blends_renders(job: StyleJob, network: FeatureNetwork):
    half, full = (painted([with_settings(job, intensity=i)], network) for i in (0.5, 1.0))
    for name in ("sh0", "shN"):
        pair = getattr(SCENE, name), getattr(full.splats, name)
        torch.testing.assert_close(getattr(half.splats, name), sum(pair) / 2)
        assert torch.equal(getattr(half.layers[0], name), getattr(full.layers[0], name))


def test_intensity_0_changes_nothing(job: StyleJob, network: FeatureNetwork):
    splats = styled_by(job, network, intensity=0.0, max_growth=GROWN)
    assert len(splats) == len(SCENE)
    assert same(splats, SCENE)


@pytest.mark.parametrize("steps", [1, 3])
def test_the_papers_steps_are_those_of_adam_at_its_rates(
    job: StyleJob, network: FeatureNetwork, steps: int
):
    """3D Gaussian splatting's code: 0.0025 for the constant band, a twentieth for the others."""
    glaring = SCENE.sh0.clone()
    glaring[job.picked] *= 3  # beyond white and black, where it stays
    scene = replace(SCENE, sh0=glaring)
    paper = replace(PRESETS["paper"], steps=steps, layers=(2,), scale=1.5)
    studio = open_studio(scene, enlarged(CAMERAS, 3), network)
    styled = paint_objects(studio, [replace(job, config=paper)])[0].splats
    before, after = scene.tensors(), styled.tensors()
    assert {n for n in before if not torch.equal(before[n], after[n])} == {"sh0", "shN"}
    for name, rate in {"sh0": 0.0025, "shN": 0.0025 / 20}.items():
        moved = (after[name] - before[name]).abs().flatten(1)
        assert not moved[~job.picked].any()
        furthest = moved[job.picked].amax(dim=1)
        assert furthest.max() == pytest.approx(steps * rate, rel=0.02)
        if steps == 1:  # Adam's first step has the same length for all that show
            shown = furthest[furthest > 0]
            torch.testing.assert_close(shown, torch.full_like(shown, rate), rtol=1e-2, atol=0)


def test_an_object_with_room_for_no_more_gaussians_is_painted_on_its_own(
    job: StyleJob, network: FeatureNetwork
):
    styled = styled_by(job, network, max_growth=1.01)  # 0.8 Gaussians more than its 80
    assert changed(styled) == {"sh0", "shN"}


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_views_that_do_not_fit_into_memory_give_the_same_picture(
    job: StyleJob,
    network: FeatureNetwork,
    precision: Precision,
):
    kept, drawn = (
        painted([job], network, max_memory=memory, precision=precision).splats
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


def test_whose_colors_the_object_has(job: StyleJob, network: FeatureNetwork):
    own = seen_colors(SCENE, job.picked).mean(dim=0)
    style = job.styles[0].reshape(-1, 3)
    ways = {
        color: seen_colors(styled_by(job, network, color=color), job.picked)
        for color in ("style", "keep", "blend")
    }
    # matched where the table shows through too, and before colours are clamped at black
    near = 0.1
    assert (ways["keep"].mean(dim=0) - own).norm() < near
    assert (ways["style"].mean(dim=0) - style.mean(dim=0)).norm() < 2.5 * near
    assert (ways["blend"].mean(dim=0) - (own + style.mean(dim=0)) / 2).norm() < near
    assert (own - style.mean(dim=0)).norm() > 4 * near
    spread, wanted = ways["style"].T.cov(), style.T.cov()
    # what the closed form spreads beyond three colours is led back to near them
    assert (spread - wanted).norm() < 0.6 * wanted.norm()


def test_features_take_the_best_match_of_several_pictures(job: StyleJob, network: FeatureNetwork):
    noise = torch.rand(44, 52, 3, generator=torch.Generator().manual_seed(0))
    both = painted([replace(job, styles=(*job.styles, noise))], network)
    twice = painted([replace(job, styles=job.styles * 2)], network)
    single = styled_by(job, network)
    assert picture_error(twice.splats, single) > picture_error(both.splats, single) + 3


def test_the_verb(job: StyleJob, network: FeatureNetwork, tmp_path: Path):
    path = tmp_path / "style.png"
    pixels = (job.styles[0] * 255).round().to(torch.uint8)
    Image.fromarray(pixels.numpy()).save(path)
    photos = [torch.zeros(36, 48, 3, dtype=torch.uint8)] * len(CAMERAS)
    rest = {"config": FAST, "network": network}
    by_file = paint(SCENE, Capture(CAMERAS, photos), job.picked, path, **rest)
    by_pixels = paint(SCENE, CAMERAS, job.picked, pixels / 255, **rest)
    assert same(by_file, by_pixels)
    with pytest.raises(StyleSplatError, match="There is no image"):
        paint(SCENE, CAMERAS, job.picked, tmp_path / "none.png", **rest)


def test_live_states_lead_to_the_same(job: StyleJob, network: FeatureNetwork):
    config = replace(FAST, intensity=0.7, max_growth=GROWN)
    rest = (SCENE, CAMERAS, job.picked, job.styles[0])
    live = paint_live(*rest, config=config, network=network)
    early = list(islice(live, 5))
    assert [state.step for state in early] == [1, 2, 3, 4, 5]
    kept = early[-1].splats.sh0.clone()
    late = list(live)  # goes on
    assert [state.step for state in late] == list(range(6, 13))
    assert all(state.steps == 12 and math.isfinite(state.nnfm) for state in early + late)
    assert same(late[-1].splats, paint(*rest, config=config, network=network))
    assert torch.equal(early[-1].splats.sh0, kept), "later steps leave earlier states alone"
    assert not torch.equal(early[-2].splats.sh0, kept)
    assert len(early[0].splats) == len(early[0].parents) == len(SCENE), "coarse steps come first"
    assert len(late[-1].splats) == len(late[-1].parents) > len(SCENE)
    assert same(early[0].base, SCENE)


def test_a_shorter_look_costs_nothing_later(job: StyleJob, network: FeatureNetwork):
    """Whoever stops asking may start again, and gets the same."""
    rest = (SCENE, CAMERAS, job.picked, job.styles[0])
    live = paint_live(*rest, config=FAST, network=network)
    next(live)
    del live
    again = paint_live(*rest, config=FAST, network=network)
    assert same(deque(again, maxlen=1).pop().splats, paint(*rest, config=FAST, network=network))


def test_unseen_objects(job: StyleJob, network: FeatureNetwork):
    faint = replace(SCENE, opacities=torch.where(job.picked, -20.0, SCENE.opacities))
    with pytest.raises(StyleSplatError, match="ball: it is seen in none of the 8 views"):
        paint_objects(open_studio(faint, CAMERAS, network), [job])
    with pytest.raises(StyleSplatError, match="ball: it is hardly visible"):
        painted([with_settings(job, object_size=4, scale=50.0)], network)


def test_all_are_looked_at_before_one_is_painted(
    job: StyleJob, network: FeatureNetwork, monkeypatch: pytest.MonkeyPatch
):
    def no_step(*_: object) -> None:
        raise AssertionError("an object was painted")

    monkeypatch.setattr("stylesplat.stylization.repaint.optimize_colors", no_step)
    small = with_settings(replace(job, name="small", picked=ball(1)), object_size=4, scale=50.0)
    with pytest.raises(StyleSplatError, match="small: it is hardly visible"):
        painted([job, small], network)
    tiny = replace(job, name="tiny", picked=ball(1), styles=(torch.rand(8, 90, 3),))
    with pytest.raises(StyleSplatError, match="Cannot take the style from this picture"):
        painted([job, tiny], network)


def test_too_few_gaussians(job: StyleJob, network: FeatureNetwork):
    few = replace(job, picked=job.picked & (torch.arange(len(SCENE)) < TABLE + 49))
    with pytest.raises(StyleSplatError, match="ball: it has 49 Gaussians"):
        painted([few], network)


def test_jobs_that_clash(job: StyleJob, network: FeatureNetwork):
    with pytest.raises(StyleSplatError, match="ball was given twice"):
        painted([job, replace(job, picked=ball(1))], network)
    with pytest.raises(StyleSplatError, match="Nothing to stylise"):
        painted([], network)


def test_small_styles(job: StyleJob, network: FeatureNetwork):
    small = replace(job, styles=(*job.styles, torch.rand(8, 90, 3)))
    with pytest.raises(StyleSplatError, match="it is 90x8 pixels"):
        painted([small], network)


def test_memory_and_grad_mode(job: StyleJob, network: FeatureNetwork):
    with pytest.raises(StyleSplatError, match="Cannot keep views in -1"):
        painted([job], network, max_memory=-1.0)
    rest = (SCENE, CAMERAS, job.picked, job.styles[0])
    with torch.no_grad():  # as a viewer may call it
        quiet = paint(*rest, config=FAST, network=network)
    assert same(quiet, paint(*rest, config=FAST, network=network))


def test_a_style_too_small_for_the_coarse_stage_is_painted_at_the_last_size(
    job: StyleJob, network: FeatureNetwork
):
    network_needs = 11 + 1  # pixels of this style image's shorter side
    height, width = job.styles[0].shape[:2]
    scale = 1.2 * network_needs * max(height, width) / min(height, width) / 24
    small = with_settings(job, object_size=24, scale=scale, steps=4)
    live = paint_live(
        SCENE, CAMERAS, small.picked, small.styles[0], config=small.config, network=network
    )
    *_, last = live
    assert (last.step, last.steps) == (4, 4)
    styled = painted([small], network)
    assert not torch.equal(styled.splats.sh0[: len(SCENE)], SCENE.sh0)


def test_soft_picks_leave_what_is_not_the_object(job: StyleJob, network: FeatureNetwork):
    """A picked Gaussian that hangs beside the ball, large and faint, keeps every bit; so with
    a canvas, and all others of the pick take on no more than the hard way gives them."""
    means, scales, opacities = (t.clone() for t in (SCENE.means, SCENE.scales, SCENE.opacities))
    means[0] += torch.tensor([0.0, 0.0, 0.5])
    scales[0], opacities[0] = math.log(0.5), -2.0
    scene = replace(SCENE, means=means, scales=scales, opacities=opacities)
    hazy = replace(job, picked=job.picked.index_fill(0, torch.tensor([0]), True))
    studio = open_studio(scene, CAMERAS, network)
    first = torch.tensor([0])
    for growth in (1.0, GROWN):
        (soft, _), (hard, _) = (
            paint_objects(studio, [with_settings(hazy, hard=hard, max_growth=growth)])
            for hard in (False, True)
        )
        assert same(soft.splats[first], scene[first])
        assert not torch.equal(hard.splats.sh0[:1], scene.sh0[:1])
        rest = (~hazy.picked).nonzero()[:, 0]
        assert same(soft.splats[rest], scene[rest])


def test_colors_are_shares_of_the_paint(job: StyleJob, network: FeatureNetwork):
    """With steps of no length and colours that are only mapped, shares tell soft from hard."""
    settings = {"steps": 1, "lr": 1e-9, "color": "free", "view_dependence": "drop"}
    soft, hard = (styled_by(job, network, hard=hard, **settings) for hard in (False, True))
    assert not hard.shN[job.picked].any()
    shares = soft_shares(SCENE, job.picked, find_places(SCENE, job.picked, CAMERAS))
    left = SCENE.shN * (1 - shares[:, None, None])
    torch.testing.assert_close(soft.shN, left, atol=1e-6, rtol=0)
    assert ((shares > 0) & (shares < 1)).any()


def test_a_pick_that_covers_nothing_by_half_has_no_object(job: StyleJob, network: FeatureNetwork):
    """Half-covered pixels are there, but no Gaussian paints most of what it does in them."""
    faint = torch.where(job.picked, -4.4, SCENE.opacities)
    scales = torch.where(job.picked[:, None], math.log(0.5), SCENE.scales)
    scene = replace(SCENE, opacities=faint, scales=scales, identities=None, classifier=None)
    studio = open_studio(scene, CAMERAS, network)
    with pytest.raises(StyleSplatError, match=r"ball: most of what each.*hard=True"):
        paint_objects(studio, [job])
