"""Laws of a base and its stack of layers."""

from dataclasses import replace

import pytest
import torch

from scenes import SETTINGS, plain_layer, rand, random_splats, two_cameras
from stylesplat.scene.layers import Composed, Layer
from stylesplat.scene.layers import compose as compose_whole
from stylesplat.scene.objects import SceneObject
from stylesplat.scene.scene import Scene
from stylesplat.scene.splats import LUMA, SH_C0, Classifier, Splats

COUNT = 60
ROWS = torch.arange(COUNT)
CLASSIFIER = Classifier(torch.zeros(2, 16), torch.zeros(2), (0, 3))
BASE = replace(random_splats(COUNT), classifier=CLASSIFIER, confidence=ROWS / COUNT)
FOX = plain_layer(BASE, ROWS[:20], "fox", surfels=30, seed=1)
POT = plain_layer(BASE, ROWS[40:], "pot", surfels=10, seed=2)
BOTH = plain_layer(BASE, ROWS[10:50], "both", surfels=5, seed=3)  # above the two
STACK = (FOX, POT, BOTH)
FOUND = {"fox": SceneObject(ROWS < 20), "nothing": SceneObject(ROWS < 0)}
SCENE = Scene(BASE, two_cameras(), objects=FOUND, metrics={"psnr": 30.0})
PAINTED = replace(SCENE.with_layers(STACK), metrics={"train": SCENE.metrics})


def compose(base: Splats, layers: list[Layer] | tuple[Layer, ...]) -> Splats:
    return compose_whole(base, layers).splats


def assert_equal(one: Splats, other: Splats) -> None:
    assert one.tensors().keys() == other.tensors().keys()
    for name, tensor in one.tensors().items():
        assert torch.equal(tensor, other.tensors()[name]), name


@pytest.mark.parametrize("gone", STACK, ids=lambda layer: layer.object)
@pytest.mark.parametrize("way", ["strength 0", "hidden"])
def test_what_does_not_show_is_as_if_it_was_removed(gone: Layer, way: str):
    """To the bit, in whatever place of the stack."""
    hidden = replace(gone, strength=0.0) if way == "strength 0" else replace(gone, visible=False)
    left = [each for each in STACK if each is not gone]
    found = compose(BASE, [hidden if each is gone else each for each in STACK])
    assert_equal(found, compose(BASE, left))
    assert_equal(PAINTED.without_layers([gone.object]).splats, found)


def test_the_base_comes_first_and_canvases_in_the_order_of_the_stack():
    splats = PAINTED.splats
    assert len(splats) == COUNT + 45
    assert torch.equal(splats.means, torch.cat([BASE.means, *(e.surfels.means for e in STACK)]))
    for name in ("means", "quats", "scales"):
        assert torch.equal(getattr(splats, name)[:COUNT], getattr(BASE, name))
    rows = torch.cat([ROWS, *(each.parents for each in STACK)])
    assert torch.equal(PAINTED.parents, rows)
    for name in ("identities", "confidence"):
        assert torch.equal(getattr(splats, name), getattr(BASE, name)[rows])
    untouched = compose(BASE, [FOX])
    assert_equal(untouched[ROWS[20:]], BASE[ROWS[20:]])


def test_colours_go_as_far_as_strength_and_share_say():
    for strength in (0.3, 1.0, 1.4):
        found = compose(BASE, [replace(FOX, strength=strength)])
        weights = (strength * FOX.shares)[:, None, None]
        for name in ("sh0", "shN"):
            wanted = torch.lerp(getattr(BASE, name)[:20], getattr(FOX, name), weights)
            torch.testing.assert_close(getattr(found, name)[:20], wanted)
    whole = compose(BASE, [replace(FOX, shares=torch.ones(20))])
    assert torch.equal(whole.sh0[:20], FOX.sh0) and torch.equal(whole.shN[:20], FOX.shN)
    assert torch.equal(whole.sh0[COUNT:], FOX.surfels.sh0), "a canvas carries its paint"
    loud = compose(BASE, [replace(FOX, strength=1.5)])
    farther = torch.lerp(FOX.surfels_sh0, FOX.surfels.sh0, torch.tensor(1.5))
    torch.testing.assert_close(loud.sh0[COUNT:], farther)


def test_opacities_fade_by_the_factors_and_canvases_appear():
    full = compose(BASE, [FOX]).opacities
    fading = FOX.opacity_factors < 1
    wanted = torch.sigmoid(BASE.opacities[:20]) * FOX.opacity_factors
    torch.testing.assert_close(torch.sigmoid(full[:20]), wanted)
    assert torch.equal(full[:20][~fading], BASE.opacities[:20][~fading])
    assert torch.equal(full[COUNT:], FOX.surfels.opacities)
    half = compose(BASE, [replace(FOX, strength=0.5)]).opacities
    assert torch.equal(half[:COUNT], BASE.opacities), "it fades once half of the canvas is there"
    assert (half[COUNT:] < FOX.surfels.opacities).all()
    strong = compose(BASE, [replace(FOX, strength=1.5)]).opacities
    assert torch.equal(strong, full), "more than all of it is not there"
    nearly = compose(BASE, [replace(FOX, strength=1 - 1e-6)]).opacities
    torch.testing.assert_close(nearly[:COUNT], full[:COUNT], atol=1e-3, rtol=1e-3)


def test_layers_keep_the_mode_that_their_base_is_rendered_in():
    """Files of layers have no mode of their own."""
    scene = replace(PAINTED, base=replace(BASE, antialiased=True))
    assert scene.splats.antialiased
    assert not PAINTED.splats.antialiased


def test_a_strength_between_changes_nothing_in_the_others():
    for strength in (0.4, 1.2):
        found = compose(BASE, [replace(FOX, strength=strength), POT])
        rows = torch.cat([ROWS[20:], torch.arange(COUNT + 30, COUNT + 40)])
        assert_equal(found[rows], compose(BASE, [FOX, POT])[rows])


def test_a_layer_above_treats_canvases_as_their_parents():
    above = replace(BOTH, shares=torch.ones(40), opacity_factors=torch.zeros(40))
    found = compose(BASE, [FOX, above])
    canvas = found[torch.arange(COUNT, COUNT + 30)]
    covered = FOX.parents >= 10
    assert covered.any() and not covered.all()
    assert torch.equal(canvas.sh0[covered], above.sh0[FOX.parents[covered] - 10])
    assert (canvas.opacities[covered] < -15).all()
    assert_equal(canvas[~covered], compose(BASE, [FOX])[COUNT:][~covered])


def test_a_mask_is_a_strength_of_each_row_and_its_surfels():
    """To the bit where it is 0, and where it is 1."""
    mask = torch.ones(20).index_fill(0, ROWS[:7], 0.0).index_fill(0, ROWS[7:12], 0.4)
    found = compose(BASE, [replace(FOX, mask=mask), POT])
    for strength, own in ((0.0, mask == 0), (1.0, mask == 1)):
        wanted = compose(BASE, [replace(FOX, strength=max(strength, 1e-9)), POT])
        rows = own.nonzero()[:, 0]
        assert_equal(found[rows], wanted[rows] if strength else BASE[rows])
        rows = COUNT + own[FOX.parents].nonzero()[:, 0]
        assert len(rows)
        assert torch.equal(found.opacities[rows], wanted.opacities[rows])
    part = compose(BASE, [replace(FOX, strength=0.4), POT])
    rows = torch.cat([ROWS[7:12], COUNT + (mask[FOX.parents] == 0.4).nonzero()[:, 0]])
    for name in ("sh0", "opacities"):
        one, other = (getattr(each, name)[rows] for each in (found, part))
        torch.testing.assert_close(one, other)
    assert_equal(compose(BASE, [replace(FOX, mask=torch.ones(20)), POT]), compose(BASE, [FOX, POT]))
    assert_equal(found[ROWS[20:]], compose(BASE, [FOX, POT])[ROWS[20:]])


def test_blends_change_the_luminosity_alone_or_all_else():
    paint = replace(FOX, shares=torch.ones(20))
    luma = torch.tensor(LUMA)
    rows = torch.cat([ROWS[:20], torch.arange(COUNT, COUNT + 30)])
    normal = compose(BASE, [paint]).sh0[rows, 0]
    under = torch.cat([BASE.sh0[:20], FOX.surfels_sh0])[:, 0]
    for blend, of_luma, of_rest in (("luminosity", normal, under), ("colour", under, normal)):
        found = compose(BASE, [replace(paint, blend=blend)]).sh0[rows, 0]
        torch.testing.assert_close(found @ luma, of_luma @ luma)
        gray = [(each - (each @ luma)[:, None]) for each in (found, of_rest)]
        torch.testing.assert_close(*gray)


def test_form_adds_relief_to_the_paint():
    painted = replace(FOX, shares=torch.ones(20), settings={**SETTINGS, "form": 0.5}, form=0.5)
    before, after = (compose(BASE, [replace(painted, form=form)]) for form in (0.5, 1.2))
    assert_equal(before, compose(BASE, [replace(painted, relief=0 * FOX.relief)]))
    rows = torch.cat([ROWS[:20], torch.arange(COUNT, COUNT + 30)])
    change = (after.sh0 - before.sh0)[rows] * SH_C0
    torch.testing.assert_close(change, (0.7 * FOX.relief)[:, None, None].expand_as(change))
    others = torch.ones(COUNT + 30, dtype=torch.bool).index_fill(0, rows, False)
    assert_equal(after[others], before[others])


def test_objects_are_rows_of_the_base_whatever_the_layers():
    for scene in (PAINTED, PAINTED.with_strengths({"fox": 0.0}), PAINTED.without_layers(["fox"])):
        assert scene.objects == SCENE.objects
        assert torch.equal(scene.to_splats(FOUND["fox"].mask), scene.parents < 20)


def test_what_comes_back_to_the_base_is_the_adjoint_of_what_goes_to_the_splats():
    for shape in ((), (3,)):
        own, all_ = rand(COUNT, *shape), rand(COUNT + 45, *shape, seed=1)
        there, back = PAINTED.to_splats(own), PAINTED.to_base(all_)
        torch.testing.assert_close((there * all_).sum(), (own * back).sum())
    assert torch.equal(PAINTED.most_of(PAINTED.to_splats(ROWS % 3 == 0)), ROWS % 3 == 0)
    sizes = PAINTED.parents.bincount()
    halves = torch.arange(COUNT + 45) >= COUNT  # all surfels, no row of the base
    assert torch.equal(PAINTED.most_of(halves), sizes > 2)


def test_the_look_is_composed_once_and_kept_as_long_as_it_is_right():
    splats = PAINTED.splats
    assert replace(PAINTED, metrics={}).splats is splats is PAINTED.splats
    changes = {"layers": STACK[:2]}, {"layers": STACK[::-1]}, {"base": BASE.detach()}
    for change in changes:
        changed = replace(PAINTED, **change)
        assert changed.splats is not splats
        assert_equal(changed.splats, compose(changed.base, changed.layers))
    assert SCENE.splats is BASE and compose(BASE, ()) is BASE
    assert PAINTED.without_layers().splats is BASE


@pytest.mark.parametrize("count", range(4))
def test_going_on_from_a_prefix_is_composing_anew(count: int):
    """To the bit; and what is no prefix is of no use."""
    stack = (FOX, replace(POT, visible=False), BOTH)
    whole, known = (compose_whole(BASE, each) for each in (stack, stack[:count]))
    others = compose_whole(BASE, stack[::-1]), Composed(BASE[ROWS], (), BASE, ROWS)
    for each in (known, *others):
        found = compose_whole(BASE, stack, each)
        assert_equal(found.splats, whole.splats)
        assert torch.equal(found.parents, whole.parents) and found.layers == stack


def test_metrics_of_layers_that_are_gone_are_forgotten():
    scene = replace(PAINTED, metrics={"nnfm": 1, "train": {"psnr": 30.0}})
    assert scene.without_layers(["fox"]).metrics == {"train": {"psnr": 30.0}}
    assert scene.without_layers().metrics == {"psnr": 30.0}


def test_a_layer_is_replaced_in_its_place_or_goes_on_top():
    for place, layer in enumerate(STACK):
        assert PAINTED.below(layer.name).layers == STACK[:place]
        other = replace(layer, strength=0.5)
        stack = PAINTED.with_layer(other).layers
        assert stack == (*STACK[:place], other, *STACK[place + 1 :])
    assert PAINTED.below("new") is PAINTED
    new = replace(FOX, object="new")
    assert PAINTED.with_layer(new).layers == (*STACK, new)
